"""An adversary that attacks one cell of a map again and again while robots patrol it."""

import dataclasses
import enum

import numpy as np
from jaxtyping import Int, UInt8

from ...markov import sample_walks
from .patrolled import PatrolledMap


# About so many attacks, as far as there are steps.
_ATTACKS = 30
_MIN_STEPS, _MAX_STEPS = 600, 1500
# Over all robots.
_MAX_PLACES = 12_000
# Steps after an attack, and the longest wait for the next.
_PAUSE, _WAIT = 8, 40


class AttackState(enum.IntEnum):
    """What the adversary does, or how its last attack ended."""

    WAITING = 0
    ATTACKING = 1
    CAUGHT = 2
    SUCCEEDED = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Attacks:
    """Robots on patrol, and what the adversary does meanwhile."""

    place: Int[np.ndarray, "times robots"]
    "The cell of each robot."
    state: UInt8[np.ndarray, "times"]
    "The [`AttackState`][] at each time."
    since: Int[np.ndarray, "times"]
    "The steps since the last attack began."
    caught: Int[np.ndarray, "times"]
    "How many attacks have failed by then."
    succeeded: Int[np.ndarray, "times"]
    "How many have not."


def simulate_attacks(patrol: PatrolledMap, seed: int) -> Attacks:
    """Move robots at random; attack the target, for the first attack time, when nobody looks.

    An attack fails if a robot has the target in view within the attack time.

    **Arguments:**

    - `patrol`: the patrol.
    - `seed`: of the robots and the adversary.
    """
    attack_time = int(patrol.attack.attack_times[0])
    steps = int(np.clip(_ATTACKS * (attack_time + _PAUSE + _WAIT // 2), _MIN_STEPS, _MAX_STEPS))
    steps = min(steps, max(_MAX_PLACES // patrol.robots, attack_time))
    random = np.random.default_rng(seed)
    walks = [
        sample_walks(policy.chain, random.choice(policy.cells, 1), steps, random)
        for policy in patrol.policies
    ]
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
        elif not seen[time]:
            now = AttackState.ATTACKING
        state[time], since[time] = now, count
    begins = np.diff(state, prepend=np.uint8(AttackState.WAITING)) != 0
    caught, succeeded = (
        np.cumsum(begins & (state == end)) for end in (AttackState.CAUGHT, AttackState.SUCCEEDED)
    )
    return Attacks(place, state, since, caught, succeeded)
