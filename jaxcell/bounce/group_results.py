import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.indices import as_array
from ..base.quantities import Checks, Result, derived, from_part, quantity
from ..mapping import GroupTotals, PeriodicGroups
from ..space import CELL_BY_CELL, CellSpace, Motion, estimates
from ..space.steps import Steps
from .dynamics import Bounces, bounce_map, bounce_shift
from .groups import bounce_groups
from .groups_on_grids import wall_groups
from .localization.filter_size import heading_filter_sizes
from .section import AngleGroups, angle_groups
from .straight_runs import Runs
from .wall_tables import Walls, walls


_Numbers: TypeAlias = Int[np.ndarray, "angles"]
_PADDING = "-1: no such group"
# Angles with a sentence of their own.
_ANSWERS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class BounceGroups(Result):
    """The periodic groups of a bouncing robot, for one or several bouncing angles.

    Quantities of single cells and of single groups are computed on first use.
    """

    title: ClassVar[str] = "Periodic groups of a bouncing robot"
    tables: ClassVar[Mapping[str, str]] = {"bounce": "groups"}

    cells: CellSpace
    motion: Motion
    bounce: Bounces
    count: Annotated[_Numbers, quantity("bounce", "periodic groups", "1", kind="count")]
    longest_transient: Annotated[
        _Numbers, quantity("bounce", "longest transient", "mappings", kind="count")
    ]
    shortest_period: Annotated[
        _Numbers, quantity("bounce", "shortest period", "mappings", kind="count")
    ]
    longest_period: Annotated[
        _Numbers, quantity("bounce", "longest period", "mappings", kind="count")
    ]
    periodic_cells: Annotated[_Numbers, quantity("bounce", "periodic cells", "1", kind="count")]
    largest_basin: Annotated[_Numbers, quantity("bounce", "largest basin", "1", kind="count")]

    @classmethod
    def of(
        cls,
        cells: CellSpace,
        bounce: Float[np.ndarray, "*angles"] | float,
        *,
        motion: Motion = CELL_BY_CELL,
    ) -> "BounceGroups":
        """Find the periodic groups of the bounce map of each angle.

        A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

            >>> import math
            >>> from jaxcell import bounce, examples
            >>> cells = examples.corridor()
            >>> groups = bounce.BounceGroups.of(cells, math.pi)
            >>> groups.longest_period.tolist(), groups.step.tolist()
            ([6], [[[0, 0, 0], [0, 0, 0]]])
        """
        angles = np.atleast_1d(np.asarray(as_array(bounce, "bounce"), float))
        shift = bounce_shift(angles, cells.directions)
        estimates.check_cells(cells, motion, estimates.counts, "numbers of groups")
        steps = Steps.of(cells, motion)
        if len(steps.offset) <= estimates.MAX_WALL_WAYS:
            return cls(cells, motion, angles, *_totals(wall_groups(Walls.of(steps), shift)))
        each = [_totals(groups.summary().totals()) for groups in _by_angle(cells, steps, shift)]
        return cls(cells, motion, angles, *map(np.concatenate, zip(*each, strict=True)))

    def by_angle(self) -> Iterator[AngleGroups]:
        """Yield the groups of each angle in a compact form, without arrays over all cells.

        [`jaxcell.record.save_cells`][] uses this method to write results that do not fit in memory.
        """
        steps = Steps.of(self.cells, self.motion)
        return _by_angle(self.cells, steps, bounce_shift(self.bounce, self.cells.directions))

    @property
    def answer(self) -> tuple[str, ...]:
        lines = [
            f"At {angle:g}° all {self.cells.size:,} cells lead to {count:,} "
            f"periodic group{'s' * (count > 1)}, after at most {transient:,} mappings; the longest "
            f"period is {period:,}."
            for angle, count, transient, period in zip(
                np.rad2deg(self.bounce).round(9).tolist(),
                *(x.tolist() for x in (self.count, self.longest_transient, self.longest_period)),
                strict=True,
            )
        ]
        rest = f"The table has {len(lines) - _ANSWERS:,} more angles."
        return tuple(lines) if len(lines) <= _ANSWERS else (*lines[:_ANSWERS], rest)

    @derived("bounce", "bouncing angle", "degree", kind="coordinate")
    def bounce_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounce)

    @derived("bounce direction position", "periodic group that the cell reaches", kind="index")
    def group(self) -> Int[np.ndarray, "angles directions positions"]:
        return self._of_cells(self._groups.group)

    @derived(
        "bounce direction position",
        "mappings until the cell is on its group",
        "mappings",
        kind="count",
    )
    def step(self) -> Int[np.ndarray, "angles directions positions"]:
        return self._of_cells(self._groups.step)

    @derived("bounce direction position", "period of that group", "mappings", kind="count")
    def period(self) -> Int[np.ndarray, "angles directions positions"]:
        rows = zip(np.asarray(self._groups.group_period), self.group, strict=True)
        return np.stack([period[group] for period, group in rows])

    @derived("bounce direction position", "whether the cell is on its group", kind="flag")
    def periodic(self) -> Bool[np.ndarray, "angles directions positions"]:
        return self.step == 0

    @derived("bounce group_index", "period of the group", "mappings", padding=_PADDING)
    def group_period(self) -> Int[np.ndarray, "angles groups"]:
        count = np.asarray(self._groups.count)
        period = np.asarray(self._groups.group_period)[:, : count.max()]
        return np.where(np.arange(period.shape[1]) < count[:, None], period, -1)

    @derived("bounce group_index", "cells that reach the group", "cells", padding=_PADDING)
    def group_basin(self) -> Int[np.ndarray, "angles groups"]:
        return self._of_groups(np.add, np.ones_like(self.group))

    @derived("bounce group_index", "longest transient", "mappings", padding=_PADDING)
    def group_transient(self) -> Int[np.ndarray, "angles groups"]:
        return self._of_groups(np.maximum, self.step)

    @functools.cached_property
    def _groups(self) -> PeriodicGroups:
        return bounce_groups(self.cells, self.bounce, motion=self.motion)

    def _of_cells(
        self, values: Int[Array | np.ndarray, "angles cells"]
    ) -> Int[np.ndarray, "angles directions positions"]:
        return np.asarray(values).reshape(-1, self.cells.directions, self.cells.positions)

    def _of_groups(
        self, collect: np.ufunc, values: Int[np.ndarray, "angles directions positions"]
    ) -> Int[np.ndarray, "angles groups"]:
        """Reduce the values of the cells in each group by `collect`; -1 pads shorter rows."""
        table = np.zeros((len(self.bounce), int(self.group.max()) + 1), np.int32)
        for row, group, of_cells in zip(table, self.group, values, strict=True):
            collect.at(row, group, of_cells)
            row[group.max() + 1 :] = -1
        return table

    def checks(self) -> Checks:
        # Basins hold all cells. A group has as many periodic cells as its period. Each basin has a
        # cell at every step up to the farthest. Each image is in the same group, one step nearer to
        # it. The totals from the walls equal those of all cells.
        angles = len(self.bounce)
        group, step = (one.reshape(angles, -1) for one in (self.group, self.step))
        image = np.asarray(bounce_map(self.cells, self.bounce, motion=self.motion).image)
        leads = np.take_along_axis(group, image, 1) == group
        nearer = np.take_along_axis(step, image, 1) == np.maximum(step - 1, 0)
        basins = periods = missing = differ = 0
        for i, count in enumerate((self.group_period >= 0).sum(axis=1).tolist()):
            period, basin, transient = (
                table[i, :count]
                for table in (self.group_period, self.group_basin, self.group_transient)
            )
            basins = max(basins, abs(int(basin.sum()) - group[i].size))
            on_group = np.bincount(group[i][step[i] == 0], minlength=count)
            periods = max(periods, int(np.abs(on_group - period).max()))
            first = np.cumsum([0, *(transient + 1)])
            occurs = np.zeros(first[-1], bool)
            occurs[np.minimum(first[group[i]] + step[i], first[-1] - 1)] = True
            missing += int(np.count_nonzero(~occurs))
            numbers = (transient.max(), period.min(), period.max(), period.sum(), basin.max())
            at_walls = [total[i] for total in _totals(self)]
            differ += int(np.count_nonzero(np.array([count, *numbers]) != at_walls))
        return {
            "basins_minus_cells": (basins, 0),
            "periodic_cells_minus_period": (periods, 0),
            "steps_that_no_cell_takes": (missing, 0),
            "image_violations": (int(np.count_nonzero(~(leads & nearer))), 0),
            "numbers_not_those_of_cells": (differ, 0),
        }


def _totals(groups: GroupTotals | BounceGroups) -> list[Int[np.ndarray, "angles"]]:
    """List the fields of [`jaxcell.mapping.GroupTotals`][] of one grid, as arrays over angles."""
    names = [field.name for field in dataclasses.fields(GroupTotals)]
    return [np.atleast_2d(getattr(groups, name))[0] for name in names]


def _by_angle(
    cells: CellSpace, steps: Steps, shift: Int[np.ndarray, "angles"]
) -> Iterator[AngleGroups]:
    runs = Runs.of(steps)
    return (angle_groups(cells, runs, [turn])[0] for turn in shift.tolist())


@dataclasses.dataclass(frozen=True, eq=False)
class RoomGroups(BounceGroups):
    """The periodic groups in a room, and the sizes of localization filters for a known heading."""

    title: ClassVar[str] = "Periodic groups of a bouncing robot in a random room"

    filter_states: Annotated[
        _Numbers,
        quantity(
            "bounce",
            "states of the filter of a robot that starts in direction 0",
            "1",
            kind="count",
        ),
    ]

    positions = from_part("cells.positions", "", "free cells of the room", "1", kind="count")

    @classmethod
    def of_room(
        cls,
        free: Bool[np.ndarray, "rows columns"],
        bounce: Float[np.ndarray, "angles"],
        directions: int,
        *,
        motion: Motion = CELL_BY_CELL,
    ) -> "RoomGroups":
        """Find the periodic groups in a room, and count the states of its localization filters.

        `free` is a mask of the free squares, whose row 0 is the lowest. `directions` and `motion`
        are arguments of [`jaxcell.bounce.walls`][].

        An open room of two rows of three squares, with turns by 90 and by 180 degrees:

            >>> import numpy as np
            >>> from jaxcell import bounce
            >>> turns = np.array([np.pi / 2, np.pi])
            >>> room = bounce.RoomGroups.of_room(np.ones((2, 3), bool), turns, directions=4)
            >>> room.longest_period.tolist(), room.filter_states.tolist()
            ([10, 6], [14, 8])
        """
        numbers = cls.numbers(free[None], bounce, directions, motion=motion)
        del numbers["positions"]
        own = {name: number[0] for name, number in numbers.items()}
        return cls(CellSpace.of_grid(free, directions), motion, bounce, **own)

    @staticmethod
    def numbers(
        free: Bool[np.ndarray, "rooms rows columns"],
        bounce: Float[np.ndarray, "angles"],
        directions: int,
        *,
        motion: Motion = CELL_BY_CELL,
        wanted: Callable[[str], bool] = lambda _: True,
    ) -> dict[str, Int[np.ndarray, "rooms angles"]]:
        """Compute the wanted quantities that are numbers, for many rooms at once.

        `wanted` returns whether a quantity is wanted, from its name. The other arguments are those
        of `of_room`, with masks of rooms of one shape.
        """
        shift, which = np.unique(bounce_shift(bounce, directions), return_inverse=True)
        known = walls(free, directions, motion=motion)
        numbers = dict(vars(wall_groups(known, shift)))
        if wanted("filter_states"):
            numbers["filter_states"] = heading_filter_sizes(known, shift)
        numbers["positions"] = np.repeat(free.sum(axis=(1, 2))[:, None], len(shift), axis=1)
        return {name: number[:, which] for name, number in numbers.items() if wanted(name)}
