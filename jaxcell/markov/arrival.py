import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate
from ..base.precision import require_x64
from ..mapping.classes import reaching
from ..mapping.generalized import Chain
from .hitting import cell_mask, common_cells, hitting_times
from .passage import check_steps, start_distribution, survivals


# Number of steps per chunk. Most short periods divide it, so that the probability of not having
# arrived shrinks by the same factor in each chunk, even if the chain is periodic.
_CHUNK = 240


@dataclasses.dataclass(frozen=True, eq=False)
class Distinct:
    """A random start of several robots in different cells; all sets of cells are equally likely."""

    cells: npt.ArrayLike
    "The possible cells, as a list or a mask over all cells."


@dataclasses.dataclass(frozen=True)
class MeanArrival:
    """An expected number of steps and its certificate."""

    value: float
    certificate: Certificate


@dataclasses.dataclass(frozen=True, eq=False)
class Race:
    """Robots that move independently until the first of them is in the target, a set of cells."""

    chains: tuple[Chain, ...]
    "The chains of the robots; a chain that several robots share is listed once."
    robot: tuple[int, ...]
    "For each robot, the index of its chain in `chains`."
    start: Float[np.ndarray, "robots cells"] | Int[np.ndarray, "choices"]
    "The distribution of each robot's start or, for a `Distinct` start, the possible cells."
    there: Bool[np.ndarray, "cells"]
    "The target, as a mask over the cells."

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        starts: Sequence[npt.ArrayLike | int] | Distinct,
        target: npt.ArrayLike | int,
    ) -> "Race":
        """Create a race from the arguments of [`first_arrival`][], after checking them."""
        cells = common_cells(chains, "robot")
        # Robots that move alike share their chain, for which survival is computed once.
        different = {id(chain): chain for chain in chains}
        number = {key: k for k, key in enumerate(different)}
        robot_chain = tuple(number[id(chain)] for chain in chains)
        if isinstance(starts, Distinct):
            start = np.flatnonzero(cell_mask(cells, starts.cells, "starts"))
            if len(different) > 1:
                raise ValueError(
                    "starts: distinct starts are for robots of one chain, the same object for each"
                )
            if start.size < len(chains):
                raise ValueError(
                    f"starts: {len(chains)} robots cannot begin in {start.size} different cells"
                )
        else:
            if len(starts) != len(chains):
                raise ValueError(
                    f"starts: expected a start for each of {len(chains)} robots, got {len(starts)}"
                )
            start = np.stack([_start(cells, robot, start) for robot, start in enumerate(starts)])
        return cls(tuple(different.values()), robot_chain, start, cell_mask(cells, target))

    @property
    def robots(self) -> int:
        return len(self.robot)

    @property
    def distinct(self) -> bool:
        return self.start.ndim == 1

    def begins(self, robot: int) -> Bool[np.ndarray, "cells"]:
        """Return the mask of the cells in which a robot may begin."""
        if self.distinct:
            return np.isin(np.arange(self.there.size), self.start)
        return self.start[robot] > 0

    def survive(
        self, values: list[Float[Array, "cells"]], chunks: int
    ) -> tuple[Float[np.ndarray, "steps"], list[Float[Array, "cells"]]]:
        """Compute the probability that no robot has arrived before each of `chunks * _CHUNK` steps.

        For each chain and start cell, `values` contains the probability that a robot has not
        arrived before the first step. Also returns these probabilities after the last step.
        """
        there, joint = jax.device_put(self.there), []
        for _ in range(chunks):
            made = [
                survivals(chain, there, value, _CHUNK)
                for chain, value in zip(self.chains, values, strict=True)
            ]
            values = [after for _, after in made]
            joint.append(self._joint([np.asarray(alone) for alone, _ in made]))
        return np.concatenate(joint), values

    def _joint(self, alone: list[Float[np.ndarray, "steps cells"]]) -> Float[np.ndarray, "steps"]:
        if not self.distinct:
            each = [alone[k] @ start for k, start in zip(self.robot, self.start, strict=True)]
            return np.prod(each, axis=0)
        return mean_product(alone[0][:, self.start], self.robots)


def first_arrival(
    chains: Sequence[Chain],
    starts: Sequence[npt.ArrayLike | int] | Distinct,
    target: npt.ArrayLike | int,
    steps: int,
) -> Float[Array, "{steps}+1"]:
    """Compute the law of the time until the first of several robots reaches a set of cells.

    The robots move independently, so the probability that none has arrived is a product of one
    probability per robot. The simulation of Alam 2018, section 4.4.6, estimates this law.

    **Arguments:** a chain for each robot, the same object for robots that move in the same way; a
    start for each robot, as in [`jaxcell.markov.first_passage`][], or [`Distinct`][] for robots of
    one chain; the target; and a number of steps.

    **Returns:** the probability that the first arrival is after `0, 1, ..., steps` steps; it is
    after 0 steps if a robot begins in the target. The cumulative sum is the probability that a
    robot has arrived by then.

    Two random walks on a line of three cells, from its middle to its right end:

        >>> from jaxcell import examples, markov
        >>> chain = examples.walk()
        >>> markov.first_arrival([chain, chain], [1, 1], target=2, steps=4).tolist()
        [0.0, 0.75, 0.0, 0.1875, 0.0]
    """
    require_x64("first_arrival")
    check_steps(steps)
    race = Race.of(chains, starts, target)
    survive, _ = race.survive(_at_start(race), steps // _CHUNK + 1)
    # If rounding let the probability grow, a probability of arrival would be negative.
    survive = np.minimum.accumulate(np.concatenate([[1.0], survive[: steps + 1]]))
    return jax.device_put(survive[:-1] - survive[1:])


def mean_first_arrival(
    chains: Sequence[Chain],
    starts: Sequence[npt.ArrayLike | int] | Distinct,
    target: npt.ArrayLike | int,
    *,
    tolerance: float = 1e-9,
    max_steps: int = 2**20,
    throw: bool = True,
) -> MeanArrival:
    """Compute the expected time in steps until the first of several robots reaches a set of cells.

    It is the sum over time of the probability that no robot has arrived. Suppose that a block of
    steps multiplies the probability that a robot has not arrived by a factor between `a` and `b`,
    whatever the start. Then the same holds for every later block of this length, so two geometric
    series bound the rest of the sum from below and above. The two bounds are nearly equal as soon
    as the factor hardly depends on the start, long before the rest is negligible.

    **Arguments:** as for [`first_arrival`][], a tolerance for the relative error, and the largest
    number of steps.

    **Returns:** the mean, `inf` if it is possible that no robot ever arrives. The residual of the
    certificate bounds the relative error, up to rounding.

    Two random walks start in the middle of a line of three cells. In every second step, the
    probability that at least one of them arrives at the right end is 3/4:

        >>> from jaxcell import examples, markov
        >>> chain = examples.walk()
        >>> round(markov.mean_first_arrival([chain, chain], [1, 1], target=2).value, 6)
        1.666667
    """
    require_x64("mean_first_arrival")
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    race = Race.of(chains, starts, target)
    if _may_fail(race):
        return MeanArrival(math.inf, Certificate(0, 0.0, tolerance))
    passed = [_passed(race, robot) for robot in range(race.robots)]
    values, total, steps, chunks = _at_start(race), 0.0, 0, 1
    while True:
        before = [np.asarray(value) for value in values]
        survive, values = race.survive(values, chunks)
        block = float(survive.sum())
        total, steps = total + block, steps + chunks * _CHUNK
        low, high = 1.0, 1.0
        for chain, (cells, leaves) in zip(race.robot, passed, strict=True):
            old, new = before[chain][cells], np.asarray(values[chain])[cells]
            ratio = new[old > 0] / old[old > 0]
            low *= float(ratio.min()) if ratio.size else 0.0
            high *= 1.0 if leaves else float(ratio.max(initial=0.0))
        least, most = _series(block, low), _series(block, high)
        value = total + (least + most) / 2
        residual = (most - least) / 2 / value if value else 0.0
        if residual <= tolerance or steps >= max_steps:
            break
        chunks *= 2
    certificate = Certificate(steps, residual, tolerance)
    certificate.check("mean_first_arrival", throw)
    return MeanArrival(value, certificate)


def mean_product(
    value: Float[np.ndarray, "steps choices"], count: int
) -> Float[np.ndarray, "steps"]:
    """Average the product of `count` values of each row over all sets of `count` columns.

    The mean is an elementary symmetric polynomial divided by its number of terms. For the first `j`
    columns, it is a weighted average of the means over the sets with and without column `j`. So
    products do not overflow, and no digits are lost by subtraction.
    """
    size = np.arange(1, count + 1)[:, None]
    mean = np.zeros((count + 1, len(value)))
    mean[0] = 1
    for j, last in enumerate(value.T, start=1):
        holds = np.minimum(size / j, 1)
        mean[1:] = (1 - holds) * mean[1:] + holds * last * mean[:-1]
    return mean[-1]


def _start(cells: int, robot: int, start: npt.ArrayLike | int) -> Float[np.ndarray, "cells"]:
    try:
        return start_distribution(cells, start)
    except ValueError as error:
        raise ValueError(f"robot {robot}: {error}") from None


def _at_start(race: Race) -> list[Float[Array, "cells"]]:
    return [jax.device_put((~race.there).astype(float))] * len(race.chains)


def _may_fail(race: Race) -> bool:
    """Check whether it is possible that no robot ever arrives."""
    fails = [np.isinf(hitting_times(chain, race.there, throw=False).value) for chain in race.chains]
    if race.distinct:
        return int(fails[0][race.start].sum()) >= race.robots
    return all((race.begins(robot) & fails[k]).any() for robot, k in enumerate(race.robot))


def _passed(race: Race, robot: int) -> tuple[Bool[np.ndarray, "cells"], bool]:
    """Find the cells that a robot may visit before arriving, and whether it may leave the space."""
    chain = race.chains[race.robot[robot]]
    on = scipy.sparse.diags_array((~race.there).astype(float), format="csr")
    # Backwards along the edges from cells outside the target.
    passed = reaching((on @ chain.to_scipy()).T.tocsr(), race.begins(robot)) & ~race.there
    return passed, bool((np.asarray(chain.leaving)[passed] > 0).any())


def _series(first: float, ratio: float) -> float:
    """Compute the sum of a geometric series without its first term."""
    if first * ratio == 0:
        return 0.0
    return first * ratio / (1 - ratio) if ratio < 1 else math.inf
