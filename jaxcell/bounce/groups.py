import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Int32, Shaped

from ..mapping import GroupSummary, PeriodicGroups, Section
from ..mapping.section import SectionCycles, bucket, section_cycles
from ..space import CellSpace, estimates
from ..space.extent import Extent
from .dynamics import Collision, Moves, bounce_shift, moves as moves_of
from .headings import Headings, SpreadGroups
from .runs import Bumps, Runs, Straight, stacked


# Between two bumps a robot runs straight, so the cells where it bumps are a section that every
# orbit meets, and every other cell is a known number of steps before one of them, in its own
# direction.


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WallGroups:
    """The periodic groups of a bouncing angle, known at the walls.

    The number of the group of a wall is `number[begin + place]`.
    """

    begin: Int[Array | np.ndarray, "*angles directions"]
    first: Int[Array | np.ndarray, "*angles directions"]
    "The first slot of the leading direction that stands for each."
    place: Int[Array | np.ndarray, "*angles slots"]
    lead: Int[Array | np.ndarray, "*angles slots"]
    "What is added to the steps to the wall, as [`jaxcell.mapping.SectionGroups`][] has them."
    number: Int[Array | np.ndarray, "*angles groups"]
    period: Int[Array | np.ndarray, "*angles groups"]
    "The period of each group; zeros past `count`."
    count: Int[Array | np.ndarray, "*angles"]


def bump_section(moves: Moves, runs: Runs, bumps: Bumps) -> Section:
    """Build the first-return map from bump to bump, of one angle.

    **Arguments:**

    - `moves`, `runs`: where a step leads, and the run that starts there.
    - `bumps`: the walls, and how the robot turns there.

    **Returns:** [`jaxcell.mapping.Section`][].
    """
    positions = runs.end.shape[1]
    here, at, live = map(jnp.asarray, (bumps.direction, bumps.position, bumps.live))
    # The robot turns, then runs to the next wall.
    turned = (here + bumps.shift) % moves.way.shape[0]
    run = moves.way[turned] * positions + at
    end = runs.end.ravel()[run]
    slot = jnp.arange(run.size, dtype=jnp.int32)
    return Section(
        successor=jnp.where(live, bumps.first[turned] + runs.rank.ravel()[run], slot),
        duration=1 + runs.length.ravel()[run],
        # Positions along a run rise or fall throughout, so its smallest cell is at one of the ends.
        lowest=turned * positions + jnp.minimum(at, end),
        live=live,
    )


def _over_angles(function: Callable[[Any], Any], angles: tuple[int, ...]) -> Callable[[Any], Any]:
    """Batch a function over angles, but for one alone, which is faster without."""
    if math.prod(angles) != 1:
        for _ in angles:
            function = jax.vmap(function)
        return function

    def alone(batch: Any) -> Any:
        one = jax.tree.map(lambda x: x.reshape(x.shape[len(angles) :]), batch)
        return jax.tree.map(lambda x: x.reshape(angles + x.shape), function(one))

    return alone


@jax.jit
def _cycles(moves: Moves, runs: Runs, bumps: Bumps) -> SectionCycles:
    return _over_angles(
        lambda bumps: section_cycles(bump_section(moves, runs, bumps)), bumps.shift.shape
    )(bumps)


@jax.jit
def _measured(
    moves: Moves, runs: Runs, bumps: Bumps, cycles: SectionCycles
) -> tuple[Int[Array, "*angles slots"], Int[Array, "*angles slots"]]:
    """The basin and the longest transient of each group of the section, at the slot that leads."""
    ways, positions = runs.end.shape
    end = runs.end + (jnp.arange(ways, dtype=jnp.int32) * positions)[:, None]
    none = jnp.zeros(ways * positions, jnp.int32)
    cells, longest = none.at[end].add(1), none.at[end].max(runs.length)

    def measure(angle):  # type: ignore[no-untyped-def]
        bumps, cycles = angle
        wall = moves.way[bumps.direction] * positions + bumps.position
        step = jnp.maximum(0, longest[wall] + cycles.lead)
        none = jnp.zeros_like(step)
        return none.at[cycles.leader].add(cells[wall]), none.at[cycles.leader].max(step)

    return _over_angles(measure, bumps.shift.shape)((bumps, cycles))


@functools.partial(jax.jit, static_argnames="walls")
def expand_groups(moves: Moves, runs: Runs, groups: WallGroups, *, walls: int) -> PeriodicGroups:
    """Expand the groups of walls to all cells.

    **Arguments:**

    - `moves`, `runs`: where a step leads, and the run that starts there.
    - `groups`: those of the walls.
    - `walls`: at least the walls of any direction.

    **Returns:** [`jaxcell.mapping.PeriodicGroups`][].
    """

    def expand(groups):  # type: ignore[no-untyped-def]
        slot = groups.first[:, None] + jnp.arange(walls, dtype=jnp.int32)[None]
        number = groups.number[groups.begin[:, None] + groups.place[slot]]

        # One direction at a time: what is gathered from is then a few hundred walls, which fit the
        # nearest cache.
        def along(direction):  # type: ignore[no-untyped-def]
            way, group, lead = direction
            rank = runs.rank[way]
            return group[rank], jnp.maximum(0, runs.length[way] + lead[rank])

        group, step = jax.lax.map(along, (moves.way, number, groups.lead[slot]))
        return PeriodicGroups(group.ravel(), step.ravel(), groups.period, groups.count)

    return _over_angles(expand, groups.count.shape)(groups)


@functools.lru_cache(maxsize=4)
def _straight(cells: CellSpace, step: float | None, collision: Collision) -> Straight:
    estimates.check(
        Extent.of(cells), lambda e: estimates.groups(e, step, collision), "groups of cells", step
    )
    with jax.ensure_compile_time_eval():
        return Straight.of(moves_of(cells, step=step, collision=collision))


@dataclasses.dataclass(frozen=True, eq=False)
class _Found:
    """The groups of the section of each angle."""

    known: Straight
    angles: tuple[int, ...]
    bumps: Bumps
    first: Int32[np.ndarray, "*angles directions"]
    "The first slot of the direction that stands for each."
    cycles: SectionCycles
    groups: list[SpreadGroups]
    "Those of all directions, for each angle."

    @classmethod
    def of(
        cls,
        cells: CellSpace,
        bounce: Float[np.ndarray, "*angles"] | Array | float | int,
        step: float | None,
        collision: Collision,
    ) -> "_Found":
        shift = bounce_shift(bounce, cells.directions)
        known = _straight(cells, step, collision)
        headings = [Headings.of(known.way, one) for one in shift.ravel().tolist()]
        bumps = known.bumps(headings, shift.shape)
        alike = np.array([one.alike for one in headings]).reshape(bumps.first.shape)
        cycles = _cycles(known.moves, known.runs, bumps)
        rows = (_rows(one, len(headings)) for one in (cycles.leads, cycles.lowest))
        groups = [
            one.spread(leads, lowest, cells.positions)
            for one, leads, lowest in zip(headings, *rows, strict=True)
        ]
        first = np.take_along_axis(bumps.first, alike, axis=-1)
        return cls(known, shift.shape, bumps, first, cycles, groups)

    @property
    def count(self) -> Int32[np.ndarray, "*angles"]:
        """The number of groups."""
        return np.array([one.slot.size for one in self.groups], np.int32).reshape(self.angles)

    def of_groups(self, values: Array) -> Int32[np.ndarray, "*angles groups"]:
        """What slots say of the groups that they stand for; zeros behind these."""
        rows = zip(_rows(values, len(self.groups)), self.groups, strict=True)
        return stacked([row[one.slot] for row, one in rows], self.angles, self._most)

    def of_walls(self) -> WallGroups:
        """The groups of the walls of all directions."""
        places = zip(self.groups, _rows(self.cycles.leader, len(self.groups)), strict=True)
        place = np.array([one.place[leader] for one, leader in places])
        return WallGroups(
            stacked([one.begin for one in self.groups], self.angles, self.known.way.size),
            self.first,
            place.reshape(*self.angles, -1),
            self.cycles.lead,
            stacked([one.number for one in self.groups], self.angles, self._most),
            self.of_groups(self.cycles.period),
            self.count,
        )

    @property
    def _most(self) -> int:
        return bucket(int(self.count.max()))


def _rows(values: Array, angles: int) -> Shaped[np.ndarray, "angles slots"]:
    return np.asarray(values).reshape(angles, -1)


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
    found = _Found.of(cells, bounce, step, collision)
    estimates.check(
        Extent.of(cells),
        lambda e: estimates.IMAGE * e.size * len(found.groups),
        "groups of all cells",
        step,
        "`record.save_cells` writes them a direction at a time, or ",
    )
    known = found.known
    walls = bucket(int(known.walls.max()))
    return expand_groups(known.moves, known.runs, found.of_walls(), walls=walls)


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
    found = _Found.of(cells, bounce, step, collision)
    known = found.known
    basin, transient = _measured(known.moves, known.runs, found.bumps, found.cycles)
    period, basin, transient = map(found.of_groups, (found.cycles.period, basin, transient))
    return GroupSummary(found.count, period, basin, transient)
