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
from .hitting import cell_mask, hitting_times
from .passage import check_steps, start_distribution, survivals


# Steps that are made at once. Most short periods divide it, for a periodic chain to shrink evenly.
_CHUNK = 240
_MAX_STEPS = 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class Distinct:
    """Starts without replacement: the robots begin in different cells, in any with equal chance."""

    cells: npt.ArrayLike
    "The cells that they may begin in: several, or a mask over all cells."


@dataclasses.dataclass(frozen=True)
class MeanArrival:
    """An expected number of steps, and how good it is."""

    value: float
    certificate: Certificate


@dataclasses.dataclass(frozen=True, eq=False)
class Race:
    """Robots that move independently until the first of them is in a set of cells."""

    chains: tuple[Chain, ...]
    "The different chains."
    robot: tuple[int, ...]
    "Which of them each robot moves by."
    start: Float[np.ndarray, "robots cells"] | Int[np.ndarray, "choices"]
    "The distribution of each robot's start, or the cells that distinct starts are drawn from."
    there: Bool[np.ndarray, "cells"]

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        starts: Sequence[npt.ArrayLike | int] | Distinct,
        target: npt.ArrayLike | int,
    ) -> "Race":
        """**Raises:** as [`first_arrival`][]."""
        if not chains:
            raise ValueError("chains: expected one for each robot, got none")
        cells = chains[0].cells
        for robot, chain in enumerate(chains):
            if chain.cells != cells:
                raise ValueError(
                    f"chains: that of robot {robot} has {chain.cells} cells, and that of robot 0 "
                    f"has {cells}"
                )
        # Robots that move alike share their chain, which is solved once.
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
                    f"starts: expected one for each of {len(chains)} robots, got {len(starts)}"
                )
            start = np.stack([_start(cells, robot, given) for robot, given in enumerate(starts)])
        return cls(tuple(different.values()), robot_chain, start, cell_mask(cells, target))

    @property
    def robots(self) -> int:
        """Number of robots."""
        return len(self.robot)

    @property
    def distinct(self) -> bool:
        """Whether the robots begin in different cells."""
        return self.start.ndim == 1

    def begins(self, robot: int) -> Bool[np.ndarray, "cells"]:
        """Where a robot may begin."""
        if self.distinct:
            return np.isin(np.arange(self.there.size), self.start)
        return self.start[robot] > 0

    def survive(
        self, values: list[Float[Array, "cells"]], chunks: int
    ) -> tuple[Float[np.ndarray, "steps"], list[Float[Array, "cells"]]]:
        """Continue the probability that no robot has arrived.

        **Arguments:**

        - `values`: for each chain, the probabilities of one robot, by its start.
        - `chunks`: how many chunks of steps to go through.

        **Returns:** the joint probability by each time, and `values` after that.
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
    """The law of the number of steps until the first of several robots is in a set of cells.

    The robots move independently, so that the probability that none has arrived is the product of
    those of each: exactly what the simulation of Alam 2018, section 4.4.6, estimates.

    **Arguments:**

    - `chains`: one for each robot; the same object for robots that move alike.
    - `starts`: one for each robot, as in [`jaxcell.markov.first_passage`][]; or [`Distinct`][]
        for robots of one chain.
    - `target`: a cell, several, or a mask over the cells.
    - `steps`: the last time that is asked for.

    **Returns:** the probability that the first time is `0, 1, ..., steps`; a robot that begins
    there arrives at 0. The running sum is the probability of capture by then.

    **Raises:** `ValueError` for chains of different spaces, starts that are not as many as the
    robots or not understood, more robots than cells for distinct starts, and as
    [`jaxcell.markov.first_passage`][].

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
    # Rounding may let it grow, which would be a negative probability.
    survive = np.minimum.accumulate(np.concatenate([[1.0], survive[: steps + 1]]))
    return jax.device_put(survive[:-1] - survive[1:])


def mean_first_arrival(
    chains: Sequence[Chain],
    starts: Sequence[npt.ArrayLike | int] | Distinct,
    target: npt.ArrayLike | int,
    *,
    tolerance: float = 1e-9,
    throw: bool = True,
) -> MeanArrival:
    """The expected number of steps until the first of several robots is in a set of cells.

    That is the sum over time of the probability that none has arrived. If within some steps the
    probabilities of a robot shrink by factors between `a` and `b`, whichever cell it started from,
    they do so ever after. Two geometric series then enclose what is left of the sum, and they meet
    long before it is negligible, when the robots have forgotten where they started.

    **Arguments:**

    - `chains`, `starts`, `target`: as in [`first_arrival`][].
    - `tolerance`: of the relative error.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`MeanArrival`][]; `inf` where it may be that none ever arrives. The residual of
    its certificate bounds the relative error, up to rounding.

    **Raises:** `ValueError` as [`first_arrival`][]; `RuntimeError` if a million steps are not
    enough.

    Two random walks on a line of three cells, from its middle to its right end, where one of them
    arrives with probability 3/4 every other step:

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
        if residual <= tolerance or steps >= _MAX_STEPS:
            break
        chunks *= 2
    certificate = Certificate(steps, residual, tolerance)
    certificate.check("mean_first_arrival", throw)
    return MeanArrival(value, certificate)


def mean_product(
    value: Float[np.ndarray, "steps choices"], count: int
) -> Float[np.ndarray, "steps"]:
    """The mean, over all sets of `count` choices, of the product of their values.

    That is an elementary symmetric polynomial over its number of terms. Among the first `j` choices
    the mean is one of the means among the first `j - 1`, with and without the last choice, weighed
    by how many sets hold it: nothing grows and nothing cancels.
    """
    size = np.arange(1, count + 1)[:, None]
    mean = np.zeros((count + 1, len(value)))
    mean[0] = 1
    for j, last in enumerate(value.T, start=1):
        holds = np.minimum(size / j, 1)
        mean[1:] = (1 - holds) * mean[1:] + holds * last * mean[:-1]
    return mean[-1]


def _start(cells: int, robot: int, given: npt.ArrayLike | int) -> Float[np.ndarray, "cells"]:
    try:
        return start_distribution(cells, given)
    except ValueError as error:
        raise ValueError(f"robot {robot}: {error}") from None


def _at_start(race: Race) -> list[Float[Array, "cells"]]:
    return [jax.device_put((~race.there).astype(float))] * len(race.chains)


def _may_fail(race: Race) -> bool:
    """Whether it may be that no robot ever arrives."""
    fails = [np.isinf(hitting_times(chain, race.there, throw=False).value) for chain in race.chains]
    if race.distinct:
        return int(fails[0][race.start].sum()) >= race.robots
    return all((race.begins(robot) & fails[k]).any() for robot, k in enumerate(race.robot))


def _passed(race: Race, robot: int) -> tuple[Bool[np.ndarray, "cells"], bool]:
    """The cells that a robot may be in before it arrives, and whether it may leave the space."""
    chain = race.chains[race.robot[robot]]
    on = scipy.sparse.diags_array((~race.there).astype(float), format="csr")
    # Backwards along the edges that leave cells off the target.
    passed = reaching((on @ chain.to_scipy()).T.tocsr(), race.begins(robot)) & ~race.there
    return passed, bool((np.asarray(chain.leaving)[passed] > 0).any())


def _series(first: float, ratio: float) -> float:
    """The sum of a geometric series after its first term."""
    if first * ratio == 0:
        return 0.0
    return first * ratio / (1 - ratio) if ratio < 1 else math.inf
