"""The straight runs of a robot between its bumps, and the section that the bumps make."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Int32

from ..mapping.section import bucket
from .dynamics import Moves, count_before
from .headings import Headings


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Runs:
    """The straight run from every position to the wall, whatever the bouncing angle."""

    end: Int[Array, "ways positions"]
    "The position where the run ends in a bump."
    length: Int[Array, "ways positions"]
    "Steps until it does."
    rank: Int[Array, "ways positions"]
    "Place of `end` among the walls of a way: how many come before it."


@jax.jit
def runs(moves: Moves) -> Runs:
    """Follow the straight run from every position in every way.

    **Arguments:**

    - `moves`: where a step leads.

    **Returns:** `Runs`, with arrays over ways and positions.
    """
    ways, positions = moves.target.shape
    position = jnp.arange(positions, dtype=jnp.int32)
    still = moves.target == position[None]
    order = moves.order[moves.line]

    # Backwards along the lines: the wall ahead is here, or where it was for the position before.
    def look_ahead(stop, here):  # type: ignore[no-untyped-def]
        index, ends = here
        stop = jnp.where(ends, index, stop)
        return stop, stop

    ends = jnp.take_along_axis(still, order, axis=1).T
    nowhere = jnp.zeros(ways, jnp.int32)
    _, stop = jax.lax.scan(look_ahead, nowhere, (position, ends), reverse=True)
    lines = jnp.arange(moves.order.shape[0], dtype=jnp.int32)[:, None]
    rank = jnp.zeros_like(moves.order).at[lines, moves.order].set(position)
    start = rank[moves.line]
    stop = jnp.take_along_axis(stop.T, start, axis=1)
    end = jnp.take_along_axis(order, stop, axis=1)
    return Runs(
        end=end,
        length=stop - start,
        rank=jnp.take_along_axis(count_before(still & moves.free[None]), end, axis=1),
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Bumps:
    """The section: where a robot may bump in its leading directions, by direction, then position.

    [`Headings`][] says which directions lead.
    """

    shift: Int[Array | np.ndarray, "*angles"]
    "Directions that the robot turns by at a bump."
    first: Int[Array | np.ndarray, "*angles directions"]
    "The first slot of each direction; those that do not lead have none."
    direction: Int[Array | np.ndarray, "*angles slots"]
    position: Int[Array | np.ndarray, "*angles slots"]
    live: Bool[Array | np.ndarray, "*angles slots"]
    "Which slots are in use."


@dataclasses.dataclass(frozen=True, eq=False)
class Straight:
    """What the walls decide, whatever the bouncing angle."""

    moves: Moves
    runs: Runs
    way: Int[np.ndarray, "directions"]
    walls: Int[np.ndarray, "directions"]
    "Number of walls of each direction."
    begin: Int[np.ndarray, "directions"]
    position: Int32[np.ndarray, "all"]
    "The positions of walls, way by way; those of each direction from `begin` on."

    @classmethod
    def of(cls, moves: Moves) -> "Straight":
        """What follows from the moves."""
        way, target = np.asarray(moves.way), np.asarray(moves.target)
        ways, position = np.nonzero(target == np.arange(target.shape[1]))
        walls = np.bincount(ways, minlength=len(target))
        begin = np.cumsum(walls) - walls
        return cls(moves, runs(moves), way, walls[way], begin[way], position.astype(np.int32))

    def section(
        self, leading: Bool[np.ndarray, "directions"]
    ) -> tuple[
        Int32[np.ndarray, "directions"], Int32[np.ndarray, "slots"], Int32[np.ndarray, "slots"]
    ]:
        """The walls of some directions, by direction, then position.

        **Arguments:**

        - `leading`: the directions.

        **Returns:** the first slot of each direction; the direction and the position of each slot.
        """
        walls = np.where(leading, self.walls, 0)
        first = (np.cumsum(walls) - walls).astype(np.int32)
        direction = np.repeat(np.arange(walls.size, dtype=np.int32), walls)
        slot = np.arange(direction.size)
        return first, direction, self.position[slot + (self.begin - first)[direction]]

    def bumps(self, headings: Sequence[Headings], angles: tuple[int, ...]) -> Bumps:
        """The section of each angle, as a batch of this shape."""
        sections = [self.section(one.leading) for one in headings]
        first, direction, position = zip(*sections, strict=True)
        size = np.array([one.size for one in position])
        slots = bucket(int(size.max()))
        return Bumps(
            np.array([one.shift for one in headings], np.int32).reshape(angles),
            stacked(first, angles, self.way.size),
            stacked(direction, angles, slots),
            stacked(position, angles, slots),
            (np.arange(slots) < size[:, None]).reshape(*angles, slots),
        )


def stacked(
    rows: Sequence[Int[np.ndarray, "_"]], angles: tuple[int, ...], size: int
) -> Int32[np.ndarray, "*angles size"]:
    """Rows that are filled up with zeros to one length."""
    table = np.zeros((len(rows), size), np.int32)
    for row, one in zip(table, rows, strict=True):
        row[: one.size] = one
    return table.reshape(*angles, size)
