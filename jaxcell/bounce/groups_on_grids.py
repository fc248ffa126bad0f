"""Totals over the periodic groups of many grids and bouncing angles at once, in NumPy.

At every bump a robot turns by the bouncing angle. After `360 / gcd(360, angle)` bumps (angle in
degrees) it has its first heading again, so the headings form independent cycles. The squares where
robots with one heading bump are the *walls* of this heading, and form its *layer*. A robot runs
from a wall of each layer to a wall of the next layer in the cycle, and from the last layer to the
first. Therefore the first-return map of the first layer determines all periodic groups of the
cycle. Headings with equal steps form a class, called a *way*, and have the same layer. Cycles with
the same ways have equal totals, so only one of them is followed.

The module `section` lists the same groups one by one. If only totals are needed, this module takes
0.6 times as long for the rooms of Figure 2.7 (the row `group_study` of the benchmarks), and a third
as long for all angles of a room (`chapter_2/angle_study.py` of the experiments).
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.callbacks import call_back
from ..base.wide import traced
from ..mapping import GroupTotals
from ..mapping.groups import follow, periodic_cells
from ..space import CELL_BY_CELL, Motion
from .dynamics import bounce_shift
from .wall_tables import Walls, walls as walls_of


_BLOCK = 1 << 15


def grid_groups(
    free: Bool[np.ndarray, "*rooms rows columns"] | Bool[Array, "*rooms rows columns"],
    bounce: Float[np.ndarray, "angles"] | float,
    directions: int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> GroupTotals:
    """Compute totals of the periodic groups of many grids, each with many bouncing angles.

    **Arguments:** masks of the free squares of grids of one shape; bouncing angles in radians,
    counter-clockwise; the other arguments are those of [`walls`][].

    **Returns:** the totals of [`jaxcell.bounce.group_summary`][] of the shape `[*rooms, angles]`,
    or `[*rooms]` for a single angle. Under `jit` and `vmap`, which may trace `free`, they are
    computed on the host.

    In an open room of 2 x 3 squares, a robot that turns by 180 degrees stays in its row or column:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> rooms = np.ones((1, 2, 3), bool)
        >>> bounce.grid_groups(rooms, math.pi, directions=4).count.tolist()
        [5]
    """
    rooms = free.shape[:-2]
    if traced(free):
        shape = jax.ShapeDtypeStruct(rooms + np.shape(bounce), np.int64)
        form = (shape,) * len(dataclasses.fields(GroupTotals))
        find = functools.partial(_on_host, bounce, directions, motion)
        return GroupTotals(*call_back(find, form, free))
    free = np.asarray(free)
    shift = bounce_shift(bounce, directions)
    flat = free.reshape(math.prod(rooms), *free.shape[-2:])
    for room in np.flatnonzero(~flat.any(axis=(1, 2))).tolist()[:1]:
        raise ValueError(f"free: expected a free square in every grid, got none in number {room}")
    totals = wall_groups(walls_of(flat, directions, motion=motion), np.atleast_1d(shift))
    fields = (getattr(totals, field.name) for field in dataclasses.fields(totals))
    return GroupTotals(*(field.reshape((*rooms, *shift.shape)) for field in fields))


def _on_host(bounce: Any, directions: int, motion: Motion, free: Any) -> tuple[Any, ...]:
    return tuple(vars(grid_groups(free, bounce, directions, motion=motion)).values())


def wall_groups(walls: Walls, shift: Int[np.ndarray, "angles"]) -> GroupTotals:
    """Compute totals of the periodic groups of grids from their walls.

    **Arguments:** the walls, and the turns at bumps as numbers of directions. **Returns:** totals
    of the shape `[grids, angles]`.

    An open room of two rows of three squares, with turns by 90 and by 180 degrees:

        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> walls = bounce.walls(np.ones((1, 2, 3), bool), directions=4)
        >>> bounce.wall_groups(walls, np.array([1, 2])).longest_period.tolist()
        [[10, 6]]
    """
    directions, grids = walls.way.size, len(walls.count)
    totals = np.zeros((6, grids, shift.size), np.int64)
    orders = directions // np.gcd(shift, directions)
    for order in np.unique(orders).tolist():
        angles = np.flatnonzero(orders == order)
        # The first heading of every cycle, and the headings after it.
        first = np.arange(directions // order)
        bumps = np.arange(order) * shift[angles, None, None]
        ways = walls.way[(first[:, None] + bumps) % directions]
        cycles, which = np.unique(ways.reshape(-1, order), axis=0, return_inverse=True)
        fields = _measured(walls, cycles)[:, :, which.reshape(ways.shape[:2])]
        for total, field, collect in zip(totals, fields, _COLLECT, strict=True):
            total[:, angles] = collect(field, axis=2)
    return GroupTotals(*totals)


_COLLECT: tuple[Callable[..., np.ndarray], ...] = (np.sum, np.max, np.min, np.max, np.sum, np.max)


def _measured(
    walls: Walls, cycles: Int[np.ndarray, "cycles order"]
) -> Int[np.ndarray, "6 grids cycles"]:
    """Compute `GroupTotals` for each grid and cycle; a row of `cycles` lists a cycle's ways."""
    grids = len(walls.count)
    tables = _Tables.of(walls)
    fields = np.empty((6, grids * len(cycles)), np.int64)
    # The places of one layer, in all cycles that are measured together, fit a cache.
    block = max(1, _BLOCK // walls.slots)
    for begin in range(0, fields.shape[1], block):
        part = np.arange(begin, min(begin + block, fields.shape[1]))
        grid, cycle = np.divmod(part, len(cycles))
        fields[:, part] = _measure(tables, grid, cycles[cycle])
    return fields.reshape(6, grids, len(cycles))


@dataclasses.dataclass(frozen=True, eq=False)
class _Tables:
    """The tables of [`Walls`][], whose leading axes are merged into one axis of rows.

    `behind` has a row for each grid and way (class of directions). The other tables have a row for
    each grid, way before a bump, and way after it.
    """

    ways: int
    next: Int[np.ndarray, "turns slots"]
    length: Int[np.ndarray, "turns slots"]
    behind: Int[np.ndarray, "layers slots"]

    @classmethod
    def of(cls, walls: Walls) -> "_Tables":
        # NumPy converts indices of other types to 64 bits each time.
        tables = walls.next.astype(np.int64), walls.length, walls.behind
        return cls(walls.behind.shape[1], *(x.reshape(-1, walls.slots) for x in tables))


def _measure(
    tables: _Tables, grid: Int[np.ndarray, "cycles"], ways: Int[np.ndarray, "cycles order"]
) -> Int[np.ndarray, "6 cycles"]:
    """Compute the six fields of `GroupTotals` for cycles of headings, each in one grid.

    `grid` contains the grid of each cycle, and `ways` the way of each of its headings. The walls in
    the same layer of all cycles are numbered by their *place*, `cycle * slots + slot`.
    """
    cycles, slots = len(ways), tables.behind.shape[1]
    layer = (grid[:, None] * tables.ways + ways).T
    turn = layer * tables.ways + np.roll(ways, -1, axis=1).T
    base = (np.arange(cycles) * slots)[:, None]
    live = (tables.behind[layer[0]] >= 0).ravel()
    image, duration = _once_around(tables, turn)
    periodic = live & periodic_cells(image)

    # As in `jaxcell.mapping.section`: `into` is the number of cells of a group on the last run to a
    # periodic place, with the place itself.
    at = np.flatnonzero(periodic)
    groups: list[tuple[np.ndarray, np.ndarray]] = []
    cells = np.zeros(live.size)
    for here, there in zip(layer, turn, strict=True):
        to = (tables.next[there] + base).ravel()
        into = 1 + tables.length[there].ravel()[at]
        cells += (tables.behind[here] + 1).ravel()
        cells = np.bincount(to, cells, live.size)
        at = to[at]
        groups.append((at, into))
    at, into = groups[-1]

    lead = np.zeros(live.size, np.int64)
    lead[at] = 1 - into
    around, _ = _leads_by_layer(tables, layer, turn, groups, lead)
    # A place whose first return is periodic may reach its group before that return.
    weight = np.where(live & ~periodic, np.where(periodic[image], around, duration), 0)
    leader, lead = follow(image, periodic, weight)
    lead[at] = 1 - into
    _, transient = _leads_by_layer(tables, layer, turn, groups, lead)

    period = np.bincount(leader[at], duration[at], live.size + 1)[:-1].astype(np.int64)
    leads = (period > 0).reshape(cycles, slots)
    period = period.reshape(cycles, slots)
    basin = np.bincount(leader, cells, live.size + 1)[:-1].reshape(cycles, slots)
    return np.stack(
        [
            leads.sum(axis=1),
            transient,
            np.where(leads, period, np.iinfo(np.int64).max).min(axis=1),
            period.max(axis=1),
            period.sum(axis=1),
            basin.max(axis=1).astype(np.int64),
        ]
    )


def _once_around(
    tables: _Tables, turn: Int[np.ndarray, "order cycles"]
) -> tuple[Int[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """Follow a robot from each wall of the first layer through all layers, back to the first.

    For each bump, `turn` contains the row of `tables.next` and `tables.length`. Returns the place
    (number of a wall) where each robot arrives, and the number of steps and bumps until then.
    """
    slots = tables.behind.shape[1]
    cycle, slot = np.divmod(np.arange(turn.shape[1] * slots), slots)
    duration = np.zeros(slot.size, np.int64)
    following, length = tables.next.ravel(), tables.length.ravel()
    for there in turn:
        run = there[cycle] * slots + slot
        slot = following[run]
        duration += 1 + length[run]
    return cycle * slots + slot, duration


def _leads_by_layer(
    tables: _Tables,
    layer: Int[np.ndarray, "order cycles"],
    turn: Int[np.ndarray, "order cycles"],
    groups: list[tuple[np.ndarray, np.ndarray]],
    lead: Int[np.ndarray, "places"],
) -> tuple[Int[np.ndarray, "places"], Int[np.ndarray, "cycles"]]:
    """Count the steps and bumps from each wall to its group; the last layer is counted first.

    `layer` contains rows of `tables.behind`, and `turn` rows of the other tables. For each layer,
    `groups` contains the periodic places (numbers of walls) in the next layer, and the number of
    periodic cells on the run that ends at each place. `lead` contains the counts of the first
    layer, to which robots run from the last layer. Returns new counts for the first layer, and the
    longest transient of each cycle.
    """
    cycles, slots = layer.shape[1], tables.behind.shape[1]
    base = (np.arange(cycles) * slots)[:, None]
    longest = np.zeros(cycles, np.int64)
    for j in reversed(range(len(layer))):
        lead = lead[tables.next[turn[j]] + base]
        lead += tables.length[turn[j]]
        np.maximum(lead, 0, out=lead)
        lead += 1
        lead = lead.ravel()
        at, into = groups[j - 1]
        lead[at] = 1 - into
        behind = tables.behind[layer[j]]
        steps = np.where(behind < 0, 0, lead.reshape(cycles, slots) + behind)
        np.maximum(longest, steps.max(axis=1), out=longest)
    return lead, longest
