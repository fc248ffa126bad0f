import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..mapping import GroupSummary, PeriodicGroups, Section, SectionGroups, section_groups
from ..mapping.section import bucket
from ..space import CellSpace, estimates
from ..space.extent import Extent
from .dynamics import Collision, Moves, bounce_shift, count_before, moves as moves_of


# Between two bumps a robot runs straight, so the cells where it bumps are a section that every
# orbit meets, and every other cell is a known number of steps before one of them, in its own
# direction.


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Runs:
    """The straight run from every position to the wall, whatever the bouncing angle."""

    end: Int[Array, "ways positions"]
    "The position where the run ends in a bump."
    length: Int[Array, "ways positions"]
    "Steps until it does."
    wall: Bool[Array, "ways positions"]
    "Where the robot bumps."
    rank: Int[Array, "ways positions"]
    "Place of `end` among the walls of a direction: how many come before it."
    first: Int[Array, "directions"]
    "First slot of each direction in the section, which lists walls by direction, then position."
    slots: Int[Array, ""]
    "Length of the section."


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
    wall = still & moves.free[None]
    walls = jnp.sum(wall, axis=1, dtype=jnp.int32)[moves.way]
    return Runs(
        end=end,
        length=stop - start,
        wall=wall,
        rank=jnp.take_along_axis(count_before(wall), end, axis=1),
        first=jnp.cumsum(walls, dtype=jnp.int32) - walls,
        slots=jnp.sum(walls, dtype=jnp.int32),
    )


def _slots(moves: Moves, runs: Runs, slots: int) -> tuple[Int[Array, "slots"], Int[Array, "slots"]]:
    """The direction and the position of the wall in each slot of the section."""
    ways, positions = runs.wall.shape
    walls = jnp.sum(runs.wall, axis=1, dtype=jnp.int32)
    start = jnp.cumsum(walls, dtype=jnp.int32) - walls
    place = jnp.where(runs.wall, start[:, None] + count_before(runs.wall), ways * positions)
    position = jnp.broadcast_to(jnp.arange(positions, dtype=jnp.int32), runs.wall.shape)
    listed = jnp.zeros(ways * positions, jnp.int32).at[place].set(position, mode="drop")
    # The direction of a slot is the number of directions, but the first, that begin at it or
    # before.
    begins = jnp.zeros(slots, jnp.int32).at[runs.first[1:]].add(1, mode="drop")
    direction = jnp.cumsum(begins, dtype=jnp.int32)
    place = start[moves.way[direction]] + jnp.arange(slots, dtype=jnp.int32) - runs.first[direction]
    return direction, listed[place]


@functools.partial(jax.jit, static_argnames="slots")
def bump_section(moves: Moves, runs: Runs, shift: Int[Array, ""] | int, *, slots: int) -> Section:
    """Build the first-return map from bump to bump.

    **Arguments:**

    - `moves`, `runs`: where a step leads, and the run that starts there.
    - `shift`: directions that the robot turns by at a bump.
    - `slots`: length of the arrays, at least `runs.slots`.

    **Returns:** [`jaxcell.mapping.Section`][].
    """
    positions = runs.wall.shape[1]
    slot = jnp.arange(slots, dtype=jnp.int32)
    direction, at = _slots(moves, runs, slots)

    # The robot turns, then runs to the next wall.
    turned = (direction + shift) % moves.way.shape[0]
    run = moves.way[turned] * positions + at
    end = runs.end.ravel()[run]
    live = slot < runs.slots
    return Section(
        successor=jnp.where(live, runs.first[turned] + runs.rank.ravel()[run], slot),
        duration=1 + runs.length.ravel()[run],
        # Positions along a run rise or fall throughout, so its smallest cell is at one of the ends.
        lowest=turned * positions + jnp.minimum(at, end),
        live=live,
    )


@jax.jit
def expand_groups(moves: Moves, runs: Runs, groups: SectionGroups) -> PeriodicGroups:
    """Expand the groups of the section to all cells.

    **Arguments:**

    - `moves`, `runs`: where a step leads, and the run that starts there.
    - `groups`: those of the section of [`bump_section`][].

    **Returns:** [`jaxcell.mapping.PeriodicGroups`][].
    """

    # One direction at a time: what is gathered from is then a few hundred slots, which fit the
    # nearest cache.
    def expand(direction):  # type: ignore[no-untyped-def]
        way = moves.way[direction]
        slot = runs.first[direction] + runs.rank[way]
        group = jnp.where(moves.free, groups.group[slot], -1)
        step = jnp.maximum(0, runs.length[way] + groups.lead[slot])
        return group, jnp.where(moves.free, step, -1)

    group, step = jax.lax.map(expand, jnp.arange(moves.way.shape[0], dtype=jnp.int32))
    return PeriodicGroups(group.ravel(), step.ravel(), groups.period, groups.count)


@jax.jit
def summarize(moves: Moves, runs: Runs, groups: SectionGroups) -> GroupSummary:
    """Summarize the groups of the section, without an array over all cells.

    **Arguments:** as for [`expand_groups`][].

    **Returns:** [`jaxcell.mapping.GroupSummary`][].
    """
    ways, positions = runs.wall.shape
    slots = groups.group.shape[0]
    end = runs.end + (jnp.arange(ways, dtype=jnp.int32) * positions)[:, None]
    end = jnp.where(moves.free[None], end, ways * positions)
    zero = jnp.zeros(ways * positions, jnp.int32)
    cells = zero.at[end].add(1, mode="drop").reshape(ways, positions)
    longest = zero.at[end].max(runs.length, mode="drop").reshape(ways, positions)

    direction, at = _slots(moves, runs, slots)
    wall = moves.way[direction], at
    live = jnp.arange(slots, dtype=jnp.int32) < runs.slots
    group = jnp.where(live, groups.group, groups.period.shape[0])
    step = jnp.maximum(0, longest[wall] + groups.lead)
    none = jnp.zeros_like(groups.period)
    return GroupSummary(
        count=groups.count,
        period=groups.period,
        basin=none.at[group].add(cells[wall], mode="drop"),
        transient=none.at[group].max(step, mode="drop"),
    )


@functools.lru_cache(maxsize=4)
def _straight(
    cells: CellSpace, step: float | None, collision: Collision
) -> tuple[Moves, Runs, int]:
    estimates.check(
        Extent.of(cells), lambda e: estimates.groups(e, step, collision), "groups of cells", step
    )
    with jax.ensure_compile_time_eval():
        possible = moves_of(cells, step=step, collision=collision)
        straight = runs(possible)
        return possible, straight, int(straight.slots)


def _section_groups(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    step: float | None,
    collision: Collision,
) -> tuple[Moves, Runs, SectionGroups]:
    shift = bounce_shift(bounce, cells.directions)
    possible, straight, slots = _straight(cells, step, collision)
    section = functools.partial(bump_section, slots=bucket(slots))
    for _ in range(shift.ndim):
        section = jax.vmap(section, in_axes=(None, None, 0))
    return possible, straight, section_groups(section(possible, straight, shift))


def bounce_groups(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> PeriodicGroups:
    """Find the periodic groups of a bounce map, by way of the section of its bumps.

    Gives what [`jaxcell.mapping.periodic_groups`][] gives for the image of
    [`jaxcell.bounce.bounce_map`][], many times faster: the rows `groups` of the benchmarks.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][]; an array of angles makes a batch.

    **Returns:** [`jaxcell.mapping.PeriodicGroups`][].

    **Raises:** `ValueError` and `MemoryError` as [`jaxcell.bounce.bounce_map`][].

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> groups = bounce.bounce_groups(cells, math.pi)
        >>> int(groups.count), groups.period.tolist()
        (1, [6, 6, 6, 6, 6, 6])
    """
    possible, straight, groups = _section_groups(cells, bounce, step, collision)
    batch = groups.count.size
    estimates.check(
        Extent.of(cells),
        lambda e: estimates.IMAGE * e.size * batch,
        "groups of all cells",
        step,
        "`record.save_cells` writes them a direction at a time, or ",
    )
    expand = functools.partial(expand_groups, possible, straight)
    for _ in range(groups.count.ndim):
        expand = jax.vmap(expand)
    return expand(groups)


def group_summary(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> GroupSummary:
    """Count the periodic groups of a bounce map, with their periods, basins and transients.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][]; an array of angles makes a batch.

    **Returns:** [`jaxcell.mapping.GroupSummary`][].

    A corridor of three squares, in which a robot goes there and back:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> found = bounce.group_summary(cells, math.pi)
        >>> int(found.count), found.period[:1].tolist(), found.basin[:1].tolist()
        (1, [6], [6])
    """
    possible, straight, groups = _section_groups(cells, bounce, step, collision)
    function = functools.partial(summarize, possible, straight)
    for _ in range(groups.count.ndim):
        function = jax.vmap(function)
    return function(groups)
