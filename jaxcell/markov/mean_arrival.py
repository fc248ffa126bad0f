import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ..base.certificate import Certificate, Real
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.generalized import Chain, ChainLike, leaving_rows, missing_rows
from .arrival import CHUNK, Distinct, Race, at_start
from .hitting import hitting_times, leaving_times, prospects


# A joint chain of at most this many states, a cell for each robot, is solved.
_JOINT = 2500
# Steps end if their rounding alone changes the mean by this part.
_HOPELESS = 1e-3
_HALF_ULP = 2.0**-53


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MeanArrival(Pictured):
    """An expected number of steps and its certificate."""

    value: Real
    certificate: Certificate


def mean_first_arrival(
    chains: Sequence[ChainLike],
    starts: Sequence[npt.ArrayLike | int] | Distinct,
    target: npt.ArrayLike | int,
    *,
    tolerance: float = 1e-9,
    max_steps: int = 2**20,
    throw: bool = True,
) -> MeanArrival:
    """Compute the expected time in steps until the first of several robots reaches a set of cells.

    A few robots on a few cells are one chain, whose state is the cells of all robots. If it has at
    most 2,500 states, it is solved like that of [`jaxcell.markov.hitting_times`][], and keeps
    nearly all digits even if the mean is 1e60 steps.

    Otherwise the mean is the sum over time of the probability that no robot has arrived. Suppose
    that a block of steps multiplies the probability that a robot has not arrived by a factor
    between `a` and `b`, whatever the start. Then the same holds for every later block of this
    length, so two geometric series bound the rest of the sum from below and above. The two bounds
    are nearly equal as soon as the factor hardly depends on the start, long before the rest is
    negligible. The rounding of each step is part of the bound: it is about 1e-15 times the mean.
    If JAX traces chains or starts, only the first way is offered; a lost robot is one more cell.

    **Arguments:** as for [`first_arrival`][jaxcell.markov.first_arrival], a tolerance for the
    relative error, and the largest number of steps.

    **Returns:** the mean, `inf` if it is possible that no robot ever arrives. The residual of the
    certificate bounds the relative error.

    Two random walks start in the middle of a line of three cells. In every second step, the
    probability that at least one of them arrives at the right end is 3/4:

        >>> from jaxcell import examples, markov
        >>> chain = examples.walk()
        >>> round(markov.mean_first_arrival([chain, chain], [1, 1], target=2).value, 6)
        1.666667
    """
    require_x64("mean_first_arrival")
    for name, number in (("tolerance", tolerance), ("max_steps", max_steps)):
        if not number > 0:
            raise ValueError(f"{name}: expected a positive number, got {number}")
    race = Race.of(chains, starts, target)
    if traced(chains, race.start):
        return _of_traced(race, tolerance)
    walkers = [_Walker.of(race, robot) for robot in range(race.robots)]
    if _may_fail(race, walkers):
        return MeanArrival(math.inf, Certificate(0, 0.0, tolerance))
    found = _by_joint_chain(race, walkers, tolerance)
    if found is None or not found.certificate.residual <= tolerance:
        stepped = _by_steps(race, walkers, tolerance, max_steps)
        known = [mean for mean in (found, stepped) if mean is not None]
        found = min(known, key=lambda mean: mean.certificate.residual)
    found.certificate.check("mean_first_arrival", throw)
    return found


def _of_traced(race: Race, tolerance: float) -> MeanArrival:
    """Compute the mean if JAX traces chains or starts, from the hitting times of the joint chain.

    The values of a traced chain are unknown, so no cell can be left out of the joint chain, as
    `_by_joint_chain` does.
    """
    cells = race.there.size + 1
    if cells**race.robots > _JOINT:
        raise ValueError(
            f"mean_first_arrival: {race.robots} robots on {cells - 1} cells and lost robots have "
            f"{cells**race.robots:,} joint states; under jit, vmap and grad at most {_JOINT:,}; "
            "use first_arrival, or call it outside"
        )
    chain = functools.reduce(_together, (_with_lost(race.chains[k]) for k in race.robot))
    place = np.indices((cells,) * race.robots).reshape(race.robots, -1)
    there = np.append(race.there, False)[place].any(axis=0)
    if race.distinct:
        apart = (np.diff(np.sort(place, axis=0), axis=0) > 0).all(axis=0)
        chosen = apart & np.isin(place, race.start).all(axis=0)
        share = chosen / chosen.sum()
    else:
        xp: Any = jnp if traced(race.start) else np
        share = functools.reduce(xp.kron, xp.pad(race.start, [(0, 0), (0, 1)]))
    time = hitting_times(chain, there, throw=False)
    counts = (share > 0) | jnp.isfinite(time.value)
    mean = jnp.where(counts, time.value, 0.0) @ share
    certificate = time.certificate
    residual: Any = jnp.where(jnp.isnan(mean), jnp.nan, certificate.residual)
    return MeanArrival(mean, Certificate(certificate.iterations, residual, tolerance))


def _with_lost(chain: Chain) -> Chain:
    """Add a last cell, in which a robot stays that has left the space."""
    lost, slots = chain.cells, chain.image.shape[0]
    image = jnp.concatenate([chain.image, jnp.full((1, lost), lost)])
    image = jnp.pad(image, [(0, 0), (0, 1)], constant_values=lost)
    chance = jnp.concatenate([chain.probability, chain.leaving[None]])
    stays = jnp.where(jnp.arange(slots + 1) == 0, 1.0, 0.0)[:, None]
    return Chain(image, jnp.hstack([chance, stays]))


def _together(first: Chain, second: Chain) -> Chain:
    """Create the chain of two chains that step at the same time, independently."""
    slots = first.image.shape[0] * second.image.shape[0]
    a, b = (x[:, None, :, None] for x in (first.image, first.probability))
    c, d = (x[None, :, None, :] for x in (second.image, second.probability))
    image, chance = a * second.cells + c, b * d
    # JAX merges one pair of axes of an array that is divided among devices, but not two at once.
    image, chance = (x.reshape(slots, *x.shape[2:]).reshape(slots, -1) for x in (image, chance))
    return Chain(image, chance)


@dataclasses.dataclass(frozen=True, eq=False)
class _Walker:
    """The cells that one robot may visit before it arrives."""

    matrix: scipy.sparse.csr_array
    can: Bool[np.ndarray, "cells"]
    "A mask of the cells from which the robot can arrive."
    may_fail: Bool[np.ndarray, "cells"]
    "A mask of the cells from which the robot may never arrive."
    passed: Bool[np.ndarray, "cells"]
    "A mask of the cells that the robot may visit before it arrives."

    @classmethod
    def of(cls, race: Race, robot: int) -> "_Walker":
        matrix = race.chains[race.robot[robot]].to_scipy()
        on = scipy.sparse.diags_array(np.asarray(~race.there, float), format="csr")
        # Backwards along the edges from cells outside the target.
        passed = reaching((on @ matrix).T.tocsr(), race.begins(robot)) & ~race.there
        return cls(matrix, *prospects(matrix, race.there), passed)

    @property
    def leaves(self) -> bool:
        """`True` if the robot may leave the space."""
        return bool((leaving_rows(self.matrix)[self.passed] > 0).any())

    @functools.cached_property
    def kept(self) -> Int[np.ndarray, "kept"]:
        """The cells that are states of the joint chain."""
        return np.flatnonzero(self.passed & self.can)

    def steps(self, there: Bool[np.ndarray, "cells"]) -> scipy.sparse.csr_array:
        """Return the matrix of steps between the cells `kept`, a lost robot, and an arrived one.

        What the probabilities of a row lack to 1 by rounding is the probability of staying.
        """
        rows = self.matrix[self.kept]
        missing, leaving = missing_rows(rows), leaving_rows(rows)
        among = rows[:, self.kept] + scipy.sparse.diags_array(missing - leaving, format="csr")
        among.data = np.maximum(among.data, 0)
        lost = rows @ (~self.can).astype(float) + leaving
        ends = np.stack([lost, rows @ there.astype(float)], axis=1)
        stays = scipy.sparse.csr_array(np.array([[1.0, 0.0], [0.0, 0.0]]))
        steps = scipy.sparse.block_array([[among, ends], [None, stays]], format="csr")
        steps.eliminate_zeros()
        return steps


def _by_joint_chain(race: Race, walkers: list[_Walker], tolerance: float) -> MeanArrival | None:
    """Solve the chain of all robots together, or return `None` if it has too many states."""
    if math.prod(walker.kept.size + 2 for walker in walkers) > _JOINT:
        return None
    matrices = [walker.steps(race.there) for walker in walkers]
    matrix = functools.reduce(functools.partial(scipy.sparse.kron, format="csr"), matrices)
    under_way = [np.append(np.ones(walker.kept.size + 1), 0) for walker in walkers]
    failing = [np.append(walker.may_fail[walker.kept], [1.0, 0.0]) for walker in walkers]
    inside = (functools.reduce(np.kron, under_way) > 0) & (functools.reduce(np.kron, failing) == 0)
    share = _distinct_shares(race, walkers[0]) if race.distinct else _shares(race, walkers)
    starts = np.flatnonzero(inside & (share > 0))
    time, certificate = np.zeros(inside.size), Certificate(0, 0.0, tolerance)
    if starts.size:
        time[inside], certificate = leaving_times(scipy.sparse.csr_array(matrix), inside)
    value = float(share[starts] @ time[starts])
    residual = certificate.residual + 2 * starts.size * _HALF_ULP
    return MeanArrival(value, Certificate(certificate.iterations, residual, tolerance))


def _shares(race: Race, walkers: list[_Walker]) -> Float[np.ndarray, "states"]:
    """Compute the distribution of the joint chain at the start."""
    each = [
        np.append(start[walker.kept], [start[~walker.can].sum(), start[race.there].sum()])
        for walker, start in zip(walkers, race.start, strict=True)
    ]
    return functools.reduce(np.kron, each)


def _distinct_shares(race: Race, walker: _Walker) -> Float[np.ndarray, "states"]:
    """Compute the distribution of the joint chain for a [`Distinct`][] start, if none arrived."""
    lost = walker.kept.size
    choices = int((~walker.can)[race.start].sum())
    place = np.indices((lost + 2,) * race.robots).reshape(race.robots, -1)
    begins = np.append(np.isin(walker.kept, race.start), [choices > 0, False])
    place = np.sort(place, axis=0)
    twice = ((place[1:] == place[:-1]) & (place[1:] < lost)).any(axis=0)
    # Robots that are lost from the start are in different cells too.
    ways = np.array([math.perm(choices, count) for count in range(race.robots + 1)], float)
    ways = ways[(place == lost).sum(axis=0)] / math.perm(race.start.size, race.robots)
    return np.where(begins[place].all(axis=0) & ~twice, ways, 0.0)


def _by_steps(race: Race, walkers: list[_Walker], tolerance: float, max_steps: int) -> MeanArrival:
    """Sum the probability that no robot has arrived, and bound the rest by geometric series."""
    # Each step of each robot rounds its probability by this part of itself.
    branches = [race.chains[k].image.shape[0] for k in race.robot]
    rounding = (sum(branches) + 6 * race.robots) * _HALF_ULP
    values, total, moment, steps, chunks = at_start(race), 0.0, 0.0, 0, 1
    while True:
        before = [np.asarray(value) for value in values]
        after, values = race.survive(values, chunks)
        survive = np.asarray(after)
        block, length = float(survive.sum()), chunks * CHUNK
        moment += float(survive @ np.arange(steps + 1, steps + length + 1))
        total, steps = total + block, steps + length
        low, high = 1.0, 1.0
        for chain, walker in zip(race.robot, walkers, strict=True):
            old, new = before[chain][walker.passed], np.asarray(values[chain])[walker.passed]
            ratio = new[old > 0] / old[old > 0]
            low *= float(ratio.min()) if ratio.size else 0.0
            high *= 1.0 if walker.leaves else float(ratio.max(initial=0.0))
        least, most = _series(block, low), _series(block, high)
        value = total + (least + most) / 2
        residual = 0.0 if value == 0 else math.inf
        if 0 < value < math.inf:
            # The later a probability, the more steps have rounded it and the ratios.
            later = moment + (most * (steps + length / (1 - high)) if most else 0.0)
            residual = ((most - least) / 2 + 2 * rounding * later) / value
        hopeless = rounding * least > max(tolerance, _HOPELESS)
        if residual <= tolerance or steps >= max_steps or hopeless:
            return MeanArrival(value, Certificate(steps, residual, tolerance))
        chunks *= 2


def _may_fail(race: Race, walkers: list[_Walker]) -> bool:
    """Check whether it is possible that no robot ever arrives."""
    if race.distinct:
        return int(walkers[0].may_fail[race.start].sum()) >= race.robots
    return all((race.begins(k) & walker.may_fail).any() for k, walker in enumerate(walkers))


def _series(first: float, ratio: float) -> float:
    """Compute the sum of a geometric series without its first term."""
    if first * ratio == 0:
        return 0.0
    return first * ratio / (1 - ratio) if ratio < 1 else math.inf
