import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Int32

from ..mapping import GroupSummary, PeriodicGroups
from ..mapping.section import bucket
from ..space import CELL_BY_CELL, CellSpace, Motion, estimates
from ..space.extent import Extent
from ..space.steps import Steps
from .dynamics import bounce_shift
from .runs import Runs
from .section import AngleGroups, angle_groups


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _ToWalls:
    """The run of each cell, whatever the bouncing angle."""

    way: Int[Array | np.ndarray, "directions"]
    wall: Int[Array | np.ndarray, "ways positions"]
    "The wall that it ends at, counted from the first one of the way."
    length: Int[Array | np.ndarray, "ways positions"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _AtWalls:
    """What [`AngleGroups`][] say of the slots of the sections, for a batch of angles.

    The number of the group of a slot is `number[begin + place]`.
    """

    begin: Int[Array | np.ndarray, "*angles directions"]
    first: Int[Array | np.ndarray, "*angles directions"]
    place: Int[Array | np.ndarray, "*angles slots"]
    lead: Int[Array | np.ndarray, "*angles slots"]
    number: Int[Array | np.ndarray, "*angles groups"]
    period: Int[Array | np.ndarray, "*angles groups"]
    "Zeros past `count`."
    count: Int[Array | np.ndarray, "*angles"]


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


@functools.partial(jax.jit, static_argnames="walls")
def _expand(to: _ToWalls, at: _AtWalls, *, walls: int) -> PeriodicGroups:
    """Expand the groups to all cells, `walls` being as many as any direction has, or more."""

    def expand(groups):  # type: ignore[no-untyped-def]
        slot = groups.first[:, None] + jnp.arange(walls, dtype=jnp.int32)[None]
        number = groups.number[groups.begin[:, None] + groups.place[slot]]

        # One direction at a time: what is gathered from is then a few hundred walls, which fit the
        # nearest cache.
        def along(direction):  # type: ignore[no-untyped-def]
            way, group, lead = direction
            wall = to.wall[way]
            return group[wall], jnp.maximum(0, to.length[way] + lead[wall])

        group, step = jax.lax.map(along, (to.way, number, groups.lead[slot]))
        return PeriodicGroups(group.ravel(), step.ravel(), groups.period, groups.count)

    return _over_angles(expand, at.count.shape)(at)


@functools.lru_cache(maxsize=4)
def _runs(cells: CellSpace, motion: Motion) -> Runs:
    estimates.check(
        Extent.of(cells), lambda e: estimates.section(e, motion), "groups of cells", motion.step
    )
    return Runs.of(Steps.of(cells, motion))


@functools.lru_cache(maxsize=4)
def _to_walls(cells: CellSpace, motion: Motion) -> _ToWalls:
    runs = _runs(cells, motion)
    # Under `jit` too this is a constant.
    with jax.ensure_compile_time_eval():
        return jax.device_put(_ToWalls(runs.steps.way, *runs.of_cells(cells)))


def _stacked(
    rows: Sequence[Int[np.ndarray, "_"]], angles: tuple[int, ...], size: int
) -> Int32[np.ndarray, "*angles size"]:
    """Rows that are filled up with zeros to one length."""
    table = np.zeros((len(rows), size), np.int32)
    for row, one in zip(table, rows, strict=True):
        row[: one.size] = one
    return table.reshape(*angles, size)


def _found(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*angles"] | Array | float | int,
    motion: Motion,
) -> tuple[list[AngleGroups], tuple[int, ...]]:
    """The groups of each angle, and the shape of the batch."""
    shift = bounce_shift(bounce, cells.directions)
    return angle_groups(cells, _runs(cells, motion), shift.ravel().tolist()), shift.shape


def bounce_groups(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
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
    found, angles = _found(cells, bounce, motion)
    estimates.check(
        Extent.of(cells),
        lambda e: estimates.IMAGE * e.size * len(found),
        "groups of all cells",
        motion.step,
        "`record.save_cells` writes them a direction at a time, or ",
    )
    most, slots = (
        bucket(max(row.size for row in rows))
        for rows in ([one.period for one in found], [one.lead for one in found])
    )
    at = _AtWalls(
        _stacked([one.groups.begin for one in found], angles, cells.directions),
        _stacked([one.first for one in found], angles, cells.directions),
        _stacked([one.groups.place[one.leader] for one in found], angles, slots),
        _stacked([one.lead for one in found], angles, slots),
        _stacked([one.groups.number for one in found], angles, most),
        _stacked([one.period for one in found], angles, most),
        np.array([one.period.size for one in found], np.int32).reshape(angles),
    )
    walls = bucket(int(np.diff(found[0].runs.begin).max()))
    return _expand(_to_walls(cells, motion), at, walls=walls)


def group_summary(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
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
    found, angles = _found(cells, bounce, motion)
    each = [one.summary() for one in found]
    most = bucket(max(one.period.size for one in each))
    count = np.array([one.period.size for one in each], np.int32).reshape(angles)
    period, basin, transient = (
        _stacked([getattr(one, name) for one in each], angles, most)
        for name in ("period", "basin", "transient")
    )
    return GroupSummary(count, period, basin, transient)
