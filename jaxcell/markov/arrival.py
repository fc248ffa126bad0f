import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Numbers
from ..base.divided import start_loop
from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping.generalized import Chain, ChainLike
from ..mapping.sequence import check_steps
from .hitting import cell_mask, common_cells
from .passage import start_distribution, survivals


# Number of steps per chunk. Most short periods divide it, so that the probability of not having
# arrived shrinks by the same factor in each chunk, even if the chain is periodic.
CHUNK = 240


@dataclasses.dataclass(frozen=True, eq=False)
class Distinct:
    """A random start of several robots in different cells; all sets of cells are equally likely."""

    cells: npt.ArrayLike
    "The possible cells, as a list or a mask over all cells."


@dataclasses.dataclass(frozen=True, eq=False)
class Race:
    """Robots that move independently until the first of them is in the target, a set of cells."""

    chains: tuple[Chain, ...]
    "The chains of the robots; a chain that several robots share is listed once."
    robot: tuple[int, ...]
    "For each robot, the index of its chain in `chains`."
    start: Float[Numbers, "robots cells"] | Int[np.ndarray, "choices"]
    "The distribution of each robot's start or, for a `Distinct` start, the possible cells."
    there: Bool[Numbers, "cells"]
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
            if not isinstance(starts, list | tuple | np.ndarray | jax.Array):
                raise ValueError(
                    f"starts: expected a list of starts, one per robot, got {type(starts).__name__}"
                )
            if len(starts) != len(chains):
                raise ValueError(
                    f"starts: expected a start for each of {len(chains)} robots, got {len(starts)}"
                )
            start = _rows([_start(cells, robot, start) for robot, start in enumerate(starts)])
        return cls(tuple(different.values()), robot_chain, start, cell_mask(cells, target))

    @property
    def robots(self) -> int:
        return len(self.robot)

    @property
    def distinct(self) -> bool:
        return self.start.ndim == 1

    def begins(self, robot: int) -> Bool[Numbers, "cells"]:
        """Return the mask of the cells in which a robot may begin."""
        if self.distinct:
            return np.isin(np.arange(self.there.size), self.start)
        return self.start[robot] > 0

    def survive(
        self, values: list[Float[Array, "cells"]], chunks: int
    ) -> tuple[Float[Array, "steps"], list[Float[Array, "cells"]]]:
        """Compute the probability that no robot has arrived before each of `chunks * CHUNK` steps.

        For each chain and start cell, `values` contains the probability that a robot has not
        arrived before the first step. Also returns these probabilities after the last step.
        """
        there, joint = jnp.asarray(self.there), []
        for _ in range(chunks):
            made = [
                survivals(chain, there, value, CHUNK)
                for chain, value in zip(self.chains, values, strict=True)
            ]
            values = [after for _, after in made]
            joint.append(self._joint([alone for alone, _ in made]))
        return jnp.concatenate(joint), values

    def _joint(self, alone: list[Float[Array, "steps cells"]]) -> Float[Array, "steps"]:
        if not self.distinct:
            starts = zip(self.robot, self.start, strict=True)
            return jnp.prod(jnp.stack([alone[k] @ start for k, start in starts]), axis=0)
        return mean_product(alone[0][:, self.start], self.robots)


def first_arrival(
    chains: Sequence[ChainLike],
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
    survive, _ = race.survive(at_start(race), steps // CHUNK + 1)
    survive = jnp.concatenate([jnp.ones(1), survive[: steps + 1]])
    arriving = survive[:-1] - survive[1:]
    # If rounding let the probability grow, a probability of arrival would be negative.
    falling = jax.lax.stop_gradient(jax.lax.cummin(survive))
    law = falling[:-1] - falling[1:] + (arriving - jax.lax.stop_gradient(arriving))
    return jnp.where(race.there.any(), law, jnp.nan)


@functools.partial(jax.jit, static_argnames="count")
def mean_product(value: Float[Array, "steps choices"], count: int) -> Float[Array, "steps"]:
    """Average the product of `count` values of each row over all sets of `count` columns.

    The mean is an elementary symmetric polynomial divided by its number of terms. For the first `j`
    columns, it is a weighted average of the means over the sets with and without column `j`. So
    products do not overflow, and no digits are lost by subtraction.
    """
    size = jnp.arange(1.0, count + 1)[:, None]

    def add(mean, column):  # type: ignore[no-untyped-def]
        number, last = column
        holds = jnp.minimum(size / number, 1)
        return mean.at[1:].set((1 - holds) * mean[1:] + holds * last[None] * mean[:-1]), None

    mean = jnp.zeros((count + 1, len(value))).at[0].set(1)
    columns = jnp.arange(1.0, value.shape[1] + 1), value.T
    return jax.lax.scan(add, start_loop(mean, value), columns)[0][-1]


def _rows(each: list[Any]) -> Any:
    if not traced(each):
        return np.stack(each)
    # JAX does not stack traced arrays and others if the axes of a mesh are explicit.
    rows = jnp.zeros((len(each), *each[0].shape))
    for number, row in enumerate(each):
        rows = rows.at[number].set(row)
    return rows


def _start(cells: int, robot: int, start: npt.ArrayLike | int) -> Float[Numbers, "cells"]:
    try:
        return start_distribution(cells, start)
    except ValueError as error:
        raise ValueError(f"robot {robot}: {error}") from None


def at_start(race: Race) -> list[Float[Array, "cells"]]:
    """Return the probability that a robot of each chain has not arrived at the start."""
    return [jnp.asarray(~race.there, float)] * len(race.chains)
