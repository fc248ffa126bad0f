import functools
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ....space.copies import copies
from ..arrival import captured_by_any, first_passage, on_device
from .polytope import ChainPolytope


# Number of programs, number of derivatives above which fewer are solved, and the least number.
_STEPS, _MANY, _FEW = 300, 100_000, 10
# Largest change of a probability in the first step.
_FIRST = 0.1
# Shorter steps are lost in rounding.
_SHORTEST = 1e-9
# Least share of the predicted gain for accepting a step, and for a longer next step.
_ENOUGH, _GOOD = 0.1, 0.75

NEAR, MOST = 0.5, 6
"""A linear program has at most `MOST` attacks per move. Their probability of capture exceeds the
least at their target by at most `NEAR` times the value, the least capture by the team."""
# Number of times that omitted attacks are added to a program if its solution violates them.
_CUTS = 8
_BROKEN = 1e-7
# Number of attacks whose derivatives are computed at once.
_ATTACKS = 64


_Moves: TypeAlias = Float[np.ndarray, "robots moves"]


class Captures:
    """The probabilities of capture by robots with given moves, and their derivatives.

    The vertices of the polytope's graph are the targets or, for a robot with memory, its states:
    pairs of a memory state and a target, where the target varies fastest.
    """

    def __init__(
        self,
        polytope: ChainPolytope,
        moves: _Moves,
        attack: Int[np.ndarray, "targets"],
        delays: int | Int[np.ndarray, "states states"] = 1,
    ) -> None:
        delays = np.broadcast_to(delays, (polytope.vertices,) * 2).astype(np.int32)
        self._polytope, self._moves, self._attack, self._delays = polytope, moves, attack, delays
        self._arguments = on_device(delays, attack)
        matrices = polytope.matrix(moves)
        self.probability = np.stack([first_passage(P, *self._arguments) for P in matrices])

    def along(
        self, robot: int, change: Float[np.ndarray, "moves"]
    ) -> Float[np.ndarray, "starts targets"]:
        """Compute the first-order change of all probabilities for a `change` of a robot's moves."""
        both = self._polytope.matrix(np.stack([self._moves[robot], change]))
        return np.asarray(_along(*both, self._arguments))

    def slopes(
        self, robot: int, starts: Int[np.ndarray, "attacks"], targets: Int[np.ndarray, "attacks"]
    ) -> Float[np.ndarray, "attacks moves"]:
        """Compute derivatives of probabilities of capture with respect to the moves of a robot.

        Those of all attacks with respect to all moves would be billions of numbers.
        """
        tails, heads = self._polytope.tails, self._polytope.heads
        order = np.argsort(tails, kind="stable")
        slot = np.empty_like(order)
        slot[order] = copies(np.bincount(tails))[1]
        shape = slot.max() + 1, self._polytope.vertices
        chance, image, lag = np.zeros(shape), np.zeros(shape, np.int32), np.zeros(shape, np.int32)
        chance[slot, tails], image[slot, tails] = self._moves[robot], heads
        lag[slot, tails] = self._delays[tails, heads] - 1
        # Each part has the same size, so that one program is compiled.
        count = -(-starts.size // _ATTACKS)
        attacks = np.stack([starts, targets, self._attack[targets] - 1], axis=1).astype(np.int32)
        parts = np.resize(attacks, (count, _ATTACKS, 3))
        given, times = (chance, image, lag), (self._attack.size, *self._arguments[-2:])
        slopes = np.concatenate([_slopes(*given, part, *times) for part in parts])
        return slopes[: starts.size, slot, tails]


@jax.jit
def _along(P: Any, change: Any, arguments: Any) -> Float[Array, "states targets"]:
    return jax.jvp(lambda P: first_passage(P, *arguments), (P,), (change,))[1]


@functools.partial(jax.jit, static_argnames="targets")
def _slopes(
    chance: Float[Array, "branches states"],
    image: Int[Array, "branches states"],
    lag: Int[Array, "branches states"],
    attacks: Int[Array, "attacks 3"],
    targets: int,
    longest: Float[Array, "delays"],
    horizon: Float[Array, "times"],
) -> Float[Array, "attacks branches states"]:
    """Compute derivatives with respect to the probability of each move to a state `image`.

    A move takes a time of `lag + 1`. A row of `attacks` is a start, a target, and the duration
    minus 1.
    """
    states = chance.shape[1]

    def captured(chance, attack):  # type: ignore[no-untyped-def]
        start, target, last = attack
        there = jnp.arange(states, dtype=attacks.dtype) % targets == target
        begin = jnp.zeros((longest.size, states)).at[0].set(there.astype(float))

        def step(later, _):  # type: ignore[no-untyped-def]
            # Row `l` of `later` is the probability with `l` less time, 1 at the target.
            now = jnp.sum(chance * later[lag, image], axis=0)
            return jnp.concatenate([jnp.where(there, 1.0, now)[None], later[:-1]]), now[start]

        return jax.lax.scan(step, begin, horizon)[1][last]

    return jax.vmap(jax.grad(captured), (None, 0))(chance, attacks)


def maximize_least_capture(
    law: Callable[[_Moves], Captures], polytope: ChainPolytope, moves: _Moves, tolerance: float
) -> tuple[_Moves, float, float, int]:
    """Maximize the least probability of capture with linear programs in trust regions.

    At a maximum of the least of smooth functions, several functions are equal, and often determine
    the maximum. Linear programs then converge as fast as Newton's method, while gradients of a soft
    minimum are slow. `law` computes the probabilities of capture at given moves.

    **Returns:** the chains of the robots, the probability, the relative gain that a linear program
    without a trust region predicts, and the number of programs.
    """
    here = law(moves)
    value = captured_by_any(here.probability).min().item()
    distance = _FIRST
    most = max(_FEW, min(_STEPS, _STEPS * _MANY // (here.probability.size * moves.shape[1])))
    for programs in range(1, most):
        trial, predicted = _program(polytope, moves, here, distance)
        # The gain without a distance is at least the gain within it.
        if predicted <= tolerance / 10 or distance < _SHORTEST:
            gain = _program(polytope, moves, here, 1.0)[1]
            if gain <= tolerance / 4 or distance < _SHORTEST:
                return moves, value, gain, programs
        there = law(trial)
        raised = captured_by_any(there.probability).min().item()
        raised_by = raised / value - 1
        distance = min(1.0, 2 * distance) if raised_by > _GOOD * predicted else distance
        if raised_by > _ENOUGH * predicted:
            moves, here, value = trial, there, raised
        else:
            distance /= 3
    return moves, value, _program(polytope, moves, here, 1.0)[1], most


def _program(
    polytope: ChainPolytope, moves: _Moves, here: Captures, distance: float
) -> tuple[_Moves, float]:
    """Find the best chains if `here` linearizes the probabilities of capture at the chains `moves`.

    No probability of a move changes by more than `distance`. The variables are the probabilities of
    the moves of each robot, the change of its least probability of capture for each target, and the
    relative change of the *value*, the least probability of capture by the team. Probabilities of
    capture are divided by the value. At first, few attacks are constraints. If the distance is 1,
    the gain serves as a bound, so attacks are added as long as the solution violates any.

    **Returns:** the chains and the predicted relative gain, which is not negative.
    """
    worst = here.probability.min(axis=1)
    value = captured_by_any(here.probability).min()
    above = (here.probability - worst[:, None, :]) / value
    known = np.zeros(above.shape, bool)
    for robot, order in enumerate(np.argsort(above.reshape(len(moves), -1), axis=1)):
        nearest = order[: MOST * moves.shape[1]]
        known[robot].flat[nearest] = above[robot].flat[nearest] <= NEAR
        # The program has a solution only with the best attack on each target.
        known[robot, above[robot].argmin(axis=0), np.arange(above.shape[2])] = True
    for _ in range(_CUTS):
        trial, least, gain = _solved(polytope, moves, here, distance, known)
        if distance < 1 or not gain:
            break
        change = [here.along(robot, trial[robot] - moves[robot]) for robot in range(len(moves))]
        broken = above + np.array(change) / value < least[:, None, :] - _BROKEN
        if not (broken & ~known).any():
            break
        known |= broken
    return trial, gain


def _solved(
    polytope: ChainPolytope,
    moves: _Moves,
    here: Captures,
    distance: float,
    known: Bool[np.ndarray, "robots starts targets"],
) -> tuple[_Moves, Float[np.ndarray, "robots targets"], float]:
    """Solve the linear program of `_program` with only the attacks in the mask `known`.

    **Returns:** the chains; for each robot and target, the increase of the least probability of
    capture over starts, divided by the value; and the relative gain of the value.
    """
    probability = here.probability
    robots, count = moves.shape
    targets = probability.shape[2]
    worst = probability.min(axis=1)
    miss = 1 - worst
    captured = captured_by_any(probability)
    value = captured.min()
    lines, sides = [], []
    for robot in range(robots):
        start, target = np.nonzero(known[robot])
        above = (probability[robot] - worst[robot])[start, target] / value
        flat = here.slopes(robot, start, target) / value
        line = np.zeros((start.size, robots * (count + targets) + 1))
        line[:, robot * count : (robot + 1) * count] = -flat
        line[np.arange(start.size), robots * count + robot * targets + target] = 1
        lines.append(line)
        sides.append(above - flat @ moves[robot])
    line = np.zeros((targets, robots * (count + targets) + 1))
    for robot in range(robots):
        others = np.delete(miss, robot, axis=0).prod(axis=0)
        first = robots * count + robot * targets
        line[:, first : first + targets] = -np.diag(others)
    line[:, -1] = 1
    lines.append(line)
    sides.append(captured / value - 1)
    sums, totals = polytope.equalities()
    equal = scipy.sparse.block_diag([scipy.sparse.csr_array(sums)] * robots)
    equal = scipy.sparse.hstack(
        [equal, scipy.sparse.csr_array((equal.shape[0], robots * targets + 1))], format="csr"
    )
    low = np.maximum(0, moves - distance).ravel()
    high = np.minimum(1, moves + distance).ravel()
    free = np.full(robots * targets + 1, np.inf)
    program = scipy.optimize.linprog(
        -np.append(np.zeros(robots * (count + targets)), 1.0),
        A_ub=np.concatenate(lines),
        b_ub=np.concatenate(sides),
        A_eq=equal,
        b_eq=np.tile(totals, robots),
        bounds=np.stack([np.append(low, -free), np.append(high, free)], axis=1),
        options={"primal_feasibility_tolerance": 1e-10},
    )
    if program.x is None:
        return moves, np.zeros((robots, targets)), 0.0
    trial = np.maximum(0, program.x[: robots * count].reshape(robots, count))
    for robot in trial:
        robot /= np.bincount(polytope.tails, robot, polytope.vertices)[polytope.tails]
    least = program.x[robots * count : -1].reshape(robots, targets)
    return trial, least, max(0.0, float(program.x[-1]))
