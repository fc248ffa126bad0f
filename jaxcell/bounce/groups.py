import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32, Shaped

from ..base.wide import traced
from ..mapping import GroupSummary, PeriodicGroups, periodic_groups
from ..space import CELL_BY_CELL, CellSpace, Motion, estimates
from ..space.steps import Steps
from .dynamics import bounce_map, bounce_shift, of_each
from .section import AngleGroups, angle_groups
from .straight_runs import Runs


@functools.lru_cache(maxsize=4)
def _runs(cells: CellSpace, motion: Motion) -> Runs:
    estimates.check_cells(cells, motion, estimates.section, "groups of cells")
    return Runs.of(Steps.of(cells, motion))


@functools.lru_cache(maxsize=4)
def _to_walls(
    cells: CellSpace, motion: Motion
) -> tuple[Int32[np.ndarray, "ways positions"], Int32[np.ndarray, "ways positions"]]:
    return _runs(cells, motion).of_cells(cells)


def padded(rows: Sequence[Shaped[np.ndarray, "_"]]) -> Shaped[np.ndarray, "rows size"]:
    """Stack rows of different lengths, padded with zeros."""
    table = np.zeros((len(rows), max(map(len, rows))), rows[0].dtype)
    for line, row in zip(table, rows, strict=True):
        line[: len(row)] = row
    return table


def _of_angles(
    cells: CellSpace, bounce: Float[np.ndarray, "*angles"] | Array | float | int, motion: Motion
) -> tuple[list[AngleGroups], tuple[int, ...]]:
    shift = bounce_shift(bounce, cells.directions)
    return angle_groups(cells, _runs(cells, motion), shift.ravel().tolist()), shift.shape


def bounce_groups(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> PeriodicGroups:
    """Find the periodic groups of a bounce map, by means of its first-return map from bump to bump.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][].

    **Returns:** the groups that [`jaxcell.mapping.periodic_groups`][] finds for that map, in a
    fraction of its time (see the rows `groups` of the benchmarks). Traced angles have the map of
    all cells, and `group_period` has an entry for each cell.

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> groups = bounce.bounce_groups(cells, math.pi)
        >>> int(groups.count), groups.period.tolist()
        (1, [6, 6, 6, 6, 6, 6])
    """
    if traced(bounce):
        return of_each(
            lambda one: periodic_groups(bounce_map(cells, one, motion=motion).image), bounce
        )
    groups, angles = _of_angles(cells, bounce, motion)
    estimates.check_cells(
        cells,
        motion,
        lambda e, _: estimates.IMAGE * e.size * len(groups),
        "groups of all cells",
        "`record.save_cells` writes them a direction at a time, or ",
    )
    wall, length = _to_walls(cells, motion)
    group, step = np.empty((2, len(groups), cells.directions, cells.positions), np.int32)
    for of_angle, numbers, steps in zip(groups, group, step, strict=True):
        for direction, way in enumerate(of_angle.runs.steps.way):
            number, lead = of_angle.of_walls(direction)
            # With mode "raise" NumPy copies the result again.
            np.take(number, wall[way], out=numbers[direction], mode="clip")
            np.maximum(0, length[way] + lead[wall[way]], out=steps[direction])
    shape, periods = (*angles, cells.size), [of_angle.period for of_angle in groups]
    return PeriodicGroups(
        group.reshape(shape),
        step.reshape(shape),
        padded(periods).reshape(*angles, -1),
        np.array([period.size for period in periods], np.int32).reshape(angles),
    )


def group_summary(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> GroupSummary:
    """Count the periodic groups of a bounce map, and find their periods, basins and transients.

    **Arguments:** as for [`jaxcell.bounce.bounce_map`][]. **Returns:** the number of groups, and
    the period, the basin and the longest transient of each group; for traced angles the arrays have
    an entry for each cell.

    A corridor of three squares, whose six cells are one periodic group:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> summary = bounce.group_summary(cells, math.pi)
        >>> int(summary.count), summary.period.tolist(), summary.basin.tolist()
        (1, [6], [6])
    """
    if traced(bounce):
        return of_each(lambda one: _summary(bounce_groups(cells, one, motion=motion)), bounce)
    groups, angles = _of_angles(cells, bounce, motion)
    each = [one.summary() for one in groups]
    count = np.array([one.period.size for one in each], np.int32)
    tables = (
        padded([getattr(one, name) for one in each]) for name in ("period", "basin", "transient")
    )
    return GroupSummary(count.reshape(angles), *(x.reshape(*angles, -1) for x in tables))


def _summary(groups: PeriodicGroups) -> GroupSummary:
    none = jnp.zeros_like(groups.group)
    basin, transient = none.at[groups.group].add(1), none.at[groups.group].max(groups.step)
    return GroupSummary(groups.count, groups.group_period, basin, transient)
