import dataclasses
import enum

import numpy as np
from jaxtyping import Int, UInt8

from ...markov import sample_walks
from .patrolled import PatrolledMap


# The approximate number of attacks, if the limits of steps allow this number.
_ATTACKS = 30
_MIN_STEPS, _MAX_STEPS = 600, 1500
# Largest number of steps times robots.
_MAX_PLACES = 12_000
# Steps after an attack, and the longest wait before the next attack.
_PAUSE, _WAIT = 8, 40


class AttackState(enum.IntEnum):
    """The activity of the adversary, or the result of its last attack."""

    WAITING = 0
    ATTACKING = 1
    CAUGHT = 2
    SUCCEEDED = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Attacks:
    """The places of patrolling robots and the attacks of an adversary."""

    place: Int[np.ndarray, "times robots"]
    state: UInt8[np.ndarray, "times"]
    "The [`AttackState`][] at each time."
    since: Int[np.ndarray, "times"]
    "The number of steps since the last attack began, at each time."
    caught: Int[np.ndarray, "times"]
    "The number of failed attacks up to each time."
    succeeded: Int[np.ndarray, "times"]
    "The number of successful attacks up to each time."


def simulate_attacks(patrol: PatrolledMap, seed: int) -> Attacks:
    """Simulate patrolling robots, and an adversary that attacks one cell while it is out of view.

    Each robot starts in a cell drawn from its shares of time. An attack takes the first of the
    attack times, and fails if a robot sees the target in this time.
    """
    attack_time = int(patrol.attack.attack_time[0])
    steps = int(np.clip(_ATTACKS * (attack_time + _PAUSE + _WAIT // 2), _MIN_STEPS, _MAX_STEPS))
    steps = min(steps, max(_MAX_PLACES // patrol.robots, attack_time))
    random = np.random.default_rng(seed)
    walks = []
    for policy in patrol.policies:
        share = policy.share_of_time(patrol.graph)
        begin = random.choice(share.size, 1, p=share / share.sum())
        walks.append(sample_walks(policy.chain, begin, steps, random))
    place = np.concatenate(walks, axis=1)
    seen = patrol.attack.view[place].any(axis=1)
    state, since = np.zeros(steps + 1, np.uint8), np.zeros(steps + 1, np.int64)
    now, count, wait = AttackState.WAITING, 0, int(random.integers(_WAIT))
    for time in range(steps + 1):
        if now is AttackState.ATTACKING:
            count += 1
            if seen[time] or count == attack_time:
                now = AttackState.CAUGHT if seen[time] else AttackState.SUCCEEDED
                wait = _PAUSE
        elif wait:
            wait -= 1
        elif now is not AttackState.WAITING:
            now, count, wait = AttackState.WAITING, 0, int(random.integers(_WAIT))
        elif seen[time]:
            # If an attack began as soon as a robot had left, the robot would still be near.
            wait = int(random.integers(_WAIT))
        else:
            now = AttackState.ATTACKING
        state[time], since[time] = now, count
    begins = np.diff(state, prepend=np.uint8(AttackState.WAITING)) != 0
    caught, succeeded = (
        np.cumsum(begins & (state == end)) for end in (AttackState.CAUGHT, AttackState.SUCCEEDED)
    )
    return Attacks(place, state, since, caught, succeeded)
