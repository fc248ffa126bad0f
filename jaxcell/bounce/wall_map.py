import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..mapping.section import bucket
from ..space import CellSpace, line_orders, stencil
from .dynamics import Collision, moves


@dataclasses.dataclass(frozen=True, eq=False)
class Walls:
    """Which wall follows which in grids of one shape, whatever the bouncing angle.

    A *way* is what directions have in common in which steps do the same (see
    [`jaxcell.bounce.Moves`][]), and a wall of a way is a free square where it bumps. At a wall of
    way `v` the robot turns; if it then goes in way `w`, it next bumps at a wall of `w`. Walls of a
    way are in slots, as many for every way and grid, the last of which is nowhere in use.
    """

    way: Int[np.ndarray, "directions"]
    "The way of each direction."
    count: Int32[np.ndarray, "grids ways"]
    "Number of walls of each way."
    behind: Int32[np.ndarray, "grids ways slots"]
    "Number of squares from which the robot runs into a wall, without its own; -1 where is none."
    next: Int32[np.ndarray, "grids ways ways slots"]
    "`next[:, v, w]` is the slot of the wall of way `w` after each wall of way `v`."
    length: Int32[np.ndarray, "grids ways ways slots"]
    "Steps that the robot makes to there from where it bumped, -1 where there is no wall."

    @property
    def slots(self) -> int:
        """Number of slots of a way."""
        return self.behind.shape[-1]

    def machine(
        self, shifts: Sequence[int], grid: int = 0
    ) -> tuple[
        Int[np.ndarray, "shifts walls"], Int[np.ndarray, "shifts walls"], Int[np.ndarray, "walls"]
    ]:
        """The walls of all directions of one grid as the states of a machine.

        **Arguments:**

        - `shifts`: by how many directions the robot may turn at a bump.
        - `grid`: the number of the grid.

        **Returns:** the next wall after each turn, the steps to it, and the squares behind each.
        """
        count = self.count[grid, self.way]
        first = np.cumsum([0, *count])
        images, lengths = np.empty((2, len(shifts), first[-1]), np.int64)
        for i, shift in enumerate(shifts):
            for d, way in enumerate(self.way.tolist()):
                after = (d + shift) % self.way.size
                here = grid, way, self.way[after], slice(count[d])
                images[i, first[d] : first[d + 1]] = first[after] + self.next[here]
                lengths[i, first[d] : first[d + 1]] = self.length[here]
        behind = [self.behind[grid, way, :size] for way, size in zip(self.way, count, strict=True)]
        return images, lengths, np.concatenate(behind)


def walls(
    free: Bool[np.ndarray, "grids rows columns"],
    directions: int,
    *,
    step: float = 1.0,
    collision: Collision = "swept",
) -> Walls:
    """Which wall follows which on grids whose blocked squares are the obstacles.

    **Arguments:** as for [`jaxcell.bounce.grid_moves`][], but for a batch of grids.

    **Returns:** [`Walls`][].

    An open room of two rows of three squares; two of them lie at the East wall and three at the
    North wall:

        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> walls = bounce.walls(np.ones((1, 2, 3), bool), directions=4)
        >>> walls.count.tolist()
        [[2, 3, 2, 3]]
    """
    if step < 1 - 1e-9:
        raise ValueError(f"step: expected at least one square, got {step}")
    shape = stencil(directions, float(step), collision, free.shape[1:])
    lines = _lines(*free.shape[1:], shape.lines)
    rooms = [
        _walls_of(one.ravel(), _still(one, directions, float(step), collision), shape.line, *lines)
        for one in free
    ]
    return _stacked(shape.way, rooms)


def cell_walls(
    cells: CellSpace, *, step: float | None = None, collision: Collision = "swept"
) -> Walls:
    """Which wall follows which on a map, as a batch of one.

    **Arguments:** as for [`jaxcell.bounce.moves`][].

    **Returns:** [`Walls`][], whose squares are positions. Where directions have few steps in common
    it is large: the square of the number of ways, times slots.

    A corridor of three squares, with the directions East and West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.cell_walls(cells).behind[0, :, 0].tolist()
        [2, 2]
    """
    possible = moves(cells, step=step, collision=collision)
    still = np.asarray(possible.target) == np.arange(cells.positions)
    order = np.asarray(possible.order, np.int64)
    lines = order, _places(order)
    room = _walls_of(np.asarray(possible.free), still, np.asarray(possible.line), *lines)
    return _stacked(np.asarray(possible.way), [room])


def _stacked(way: Int[np.ndarray, "directions"], rooms: "list[_RoomWalls]") -> Walls:
    ways = int(way.max()) + 1
    count = np.array([np.diff(room.start) for room in rooms], np.int32).reshape(-1, ways)
    slots = bucket(int(count.max(initial=0)) + 1)
    live = np.arange(slots) < count[..., None]
    behind = np.full(live.shape, -1, np.int32)
    after = np.full((len(rooms), ways, ways, slots), slots - 1, np.int32)
    length = np.full(after.shape, -1, np.int32)
    for i, room in enumerate(rooms):
        behind[i][live[i]] = room.behind
        for w in range(ways):
            after[i, :, w][live[i]] = room.next[w]
            length[i, :, w][live[i]] = room.length[w]
    return Walls(way, count, behind, after, length)


@dataclasses.dataclass(frozen=True, eq=False)
class _RoomWalls:
    """The walls of one grid, those of one way after those of another."""

    start: Int[np.ndarray, "_"]
    behind: Int[np.ndarray, "walls"]
    next: Int[np.ndarray, "ways walls"]
    length: Int[np.ndarray, "ways walls"]


def _walls_of(
    is_free: Bool[np.ndarray, "squares"],
    still: Bool[np.ndarray, "ways *squares"],
    lines: Int[np.ndarray, "ways"],
    order: Int[np.ndarray, "lines squares"],
    place: Int[np.ndarray, "lines squares"],
) -> _RoomWalls:
    found = []
    squares, behind = [], []
    for line, ends in zip(lines.tolist(), still, strict=True):
        # Along its lines, the squares of a way are runs that end in a stop: a wall, or an obstacle.
        stopped = ends.ravel()[order[line]]
        stops = np.flatnonzero(stopped)
        square = order[line][stops]
        free_stop = is_free[square]
        squares.append(square[free_stop])
        behind.append((np.diff(stops, prepend=-1) - 1)[free_stop])
        before = np.cumsum(stopped, dtype=np.int32) - stopped
        found.append((stops, before, np.cumsum(free_stop) - 1, place[line]))
    start = np.cumsum([0, *map(len, squares)])
    at = np.concatenate(squares)
    after, length = np.empty((2, len(found), at.size), np.int32)
    for w, (stops, before, slot, place_on_line) in enumerate(found):
        here = place_on_line[at]
        stop = before[here]
        after[w], length[w] = slot[stop], stops[stop] - here
    return _RoomWalls(start, np.concatenate(behind), after, length)


@functools.lru_cache(maxsize=16)
def _lines(
    rows: int, columns: int, lines: tuple[tuple[int, int], ...]
) -> tuple[Int[np.ndarray, "lines squares"], Int[np.ndarray, "lines squares"]]:
    """The squares line by line, and the place of each square among them."""
    # NumPy takes by 64-bit numbers, and turns others into them each time.
    order = line_orders(rows, columns, lines).astype(np.int64)
    return order, _places(order)


def _places(order: Int[np.ndarray, "lines squares"]) -> Int[np.ndarray, "lines squares"]:
    place = np.empty_like(order)
    np.put_along_axis(place, order, np.arange(order.shape[1])[None], axis=1)
    return place


def _still(
    free: Bool[np.ndarray, "rows columns"], directions: int, step: float, collision: Collision
) -> Bool[np.ndarray, "ways rows columns"]:
    """Whether no step in a way is possible from a square, or the square is not free."""
    shape = stencil(directions, step, collision, free.shape)
    rows, columns = free.shape
    margin = int(np.abs(shape.square).max())
    framed = np.pad(free, margin)
    looks = [
        framed[margin + up : margin + up + rows, margin + across : margin + across + columns]
        for up, across in shape.square.tolist()
    ]
    still = np.empty((len(shape.offset), rows, columns), bool)
    for w, (crossed, beside) in enumerate(zip(shape.crossed, shape.beside, strict=True)):
        # Lists of looks are filled up with repeats.
        passes = free.copy()
        for square in dict.fromkeys(crossed.tolist()):
            passes &= looks[square]
        for left, right in dict.fromkeys(map(tuple, beside.tolist())):
            passes &= looks[left] | looks[right]
        np.logical_not(passes, out=still[w])
    return still
