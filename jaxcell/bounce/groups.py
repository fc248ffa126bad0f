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
from ..space.steps import Steps
from .dynamics import bounce_shift
from .section import AngleGroups, angle_groups
from .straight_runs import Runs


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _ToWalls:
    """The straight run from each cell to a wall, which is the same for all bouncing angles."""

    way: Int[Array | np.ndarray, "directions"]
    wall: Int[Array | np.ndarray, "ways positions"]
    "The number of the wall at the end of the run, counted from 0 in each way."
    length: Int[Array | np.ndarray, "ways positions"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _AtWalls:
    """The fields of [`AngleGroups`][] for a batch of angles, padded with zeros to equal lengths.

    A robot that bumps at slot `s` in direction `d` is in group `number[begin[d] + place[s]]`.
    """

    begin: Int[Array | np.ndarray, "*angles directions"]
    first: Int[Array | np.ndarray, "*angles directions"]
    place: Int[Array | np.ndarray, "*angles slots"]
    lead: Int[Array | np.ndarray, "*angles slots"]
    number: Int[Array | np.ndarray, "*angles groups"]
    period: Int[Array | np.ndarray, "*angles groups"]
    "The period of each group; the first `count` are in use."
    count: Int[Array | np.ndarray, "*angles"]


def _over_angles(function: Callable[[Any], Any], angles: tuple[int, ...]) -> Callable[[Any], Any]:
    """Map a function over axes of angles. A single angle does without `vmap`, which is slower."""
    if math.prod(angles) != 1:
        for _ in angles:
            function = jax.vmap(function)
        return function

    def alone(batch: Any) -> Any:
        single = jax.tree.map(lambda x: x.reshape(x.shape[len(angles) :]), batch)
        return jax.tree.map(lambda x: x.reshape(angles + x.shape), function(single))

    return alone


@functools.partial(jax.jit, static_argnames="walls")
def _expand(to: _ToWalls, at: _AtWalls, *, walls: int) -> PeriodicGroups:
    """Find the group of each cell by the wall ahead; a direction has at most `walls` walls."""

    def expand(groups):  # type: ignore[no-untyped-def]
        slot = groups.first[:, None] + jnp.arange(walls, dtype=jnp.int32)[None]
        number = groups.number[groups.begin[:, None] + groups.place[slot]]

        # One direction at a time, because its few hundred walls fit the fastest cache.
        def along(direction):  # type: ignore[no-untyped-def]
            way, group, lead = direction
            wall = to.wall[way]
            return group[wall], jnp.maximum(0, to.length[way] + lead[wall])

        group, step = jax.lax.map(along, (to.way, number, groups.lead[slot]))
        return PeriodicGroups(group.ravel(), step.ravel(), groups.period, groups.count)

    return _over_angles(expand, at.count.shape)(at)


@functools.lru_cache(maxsize=4)
def _runs(cells: CellSpace, motion: Motion) -> Runs:
    estimates.check_cells(cells, motion, estimates.section, "groups of cells")
    return Runs.of(Steps.of(cells, motion))


@functools.lru_cache(maxsize=4)
def _to_walls(cells: CellSpace, motion: Motion) -> _ToWalls:
    runs = _runs(cells, motion)
    # The result is a constant, under `jit` too.
    with jax.ensure_compile_time_eval():
        return jax.device_put(_ToWalls(runs.steps.way, *runs.of_cells(cells)))


def _stacked(
    rows: Sequence[Int[np.ndarray, "_"]], angles: tuple[int, ...], size: int
) -> Int32[np.ndarray, "*angles size"]:
    """Stack rows, padded with zeros to one length."""
    table = np.zeros((len(rows), size), np.int32)
    for line, row in zip(table, rows, strict=True):
        line[: row.size] = row
    return table.reshape(*angles, size)


def _of_angles(
    cells: CellSpace, bounce: Float[np.ndarray, "*angles"] | Array | float | int, motion: Motion
) -> tuple[list[AngleGroups], tuple[int, ...]]:
    """Find the groups of each angle, and the shape of the batch."""
    shift = bounce_shift(bounce, cells.directions)
    return angle_groups(cells, _runs(cells, motion), shift.ravel().tolist()), shift.shape


def bounce_groups(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> PeriodicGroups:
    """Find the periodic groups of a bounce map by its first-return map from bump to bump.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][], with its errors.

    **Returns:** the result of [`jaxcell.mapping.periodic_groups`][] for that map, but many times
    faster (the rows `groups` of the benchmarks).

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> groups = bounce.bounce_groups(cells, math.pi)
        >>> int(groups.count), groups.period.tolist()
        (1, [6, 6, 6, 6, 6, 6])
    """
    groups, angles = _of_angles(cells, bounce, motion)
    estimates.check_cells(
        cells,
        motion,
        lambda e, _: estimates.IMAGE * e.size * len(groups),
        "groups of all cells",
        "`record.save_cells` writes them a direction at a time, or ",
    )
    most = bucket(max(one.period.size for one in groups))
    slots = bucket(max(one.lead.size for one in groups))
    at = _AtWalls(
        _stacked([one.groups.begin for one in groups], angles, cells.directions),
        _stacked([one.first for one in groups], angles, cells.directions),
        _stacked([one.groups.place[one.leader] for one in groups], angles, slots),
        _stacked([one.lead for one in groups], angles, slots),
        _stacked([one.groups.number for one in groups], angles, most),
        _stacked([one.period for one in groups], angles, most),
        np.array([one.period.size for one in groups], np.int32).reshape(angles),
    )
    walls = bucket(int(np.diff(groups[0].runs.begin).max()))
    return _expand(_to_walls(cells, motion), at, walls=walls)


def group_summary(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> GroupSummary:
    """Count the periodic groups of a bounce map, with their periods, basins and transients.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][]. **Returns:** the number of groups, and
    the period, the basin and the longest transient of each group.

    A corridor of three squares, whose six cells are one periodic group:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> summary = bounce.group_summary(cells, math.pi)
        >>> int(summary.count), summary.period[:1].tolist(), summary.basin[:1].tolist()
        (1, [6], [6])
    """
    groups, angles = _of_angles(cells, bounce, motion)
    each = [one.summary() for one in groups]
    most = bucket(max(one.period.size for one in each))
    count = np.array([one.period.size for one in each], np.int32).reshape(angles)
    tables = (
        _stacked([getattr(one, name) for one in each], angles, most)
        for name in ("period", "basin", "transient")
    )
    return GroupSummary(count, *tables)
