import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..mapping.section import bucket
from ..space import CellSpace, stencil
from ..space.stencils import GridLines, Stencil
from .dynamics import Collision, moves, step_in_cells


# Squares of grids whose lines are listed; of larger ones that takes longer than it saves.
_SMALL = 2**20


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
    along = [lines[line] for line in shape.line.tolist()]
    rooms = [_walls_of(one.ravel(), _still(one, shape), along) for one in free]
    return _stacked(shape.way, rooms)


def cell_walls(
    cells: CellSpace, *, step: float | None = None, collision: Collision = "swept"
) -> Walls:
    """Which wall follows which on a map, as a batch of one.

    **Arguments:** as for [`jaxcell.bounce.moves`][].

    **Returns:** [`Walls`][]. Where directions have few steps in common they are many: the square of
    the number of ways, times slots.

    **Raises:** as [`jaxcell.bounce.moves`][].

    A corridor of three squares, with the directions East and West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.cell_walls(cells).behind[0, :, 0].tolist()
        [2, 2]
    """
    if cells.gridded:
        return walls(
            cells.free[None],
            cells.directions,
            step=step_in_cells(cells, step, collision),
            collision=collision,
        )
    possible = moves(cells, step=step, collision=collision)
    still = np.asarray(possible.target) == np.arange(cells.positions)
    lines = [_Listed.of(order) for order in np.asarray(possible.order, np.int64)]
    along = [lines[line] for line in np.asarray(possible.line).tolist()]
    return _stacked(np.asarray(possible.way), [_walls_of(np.asarray(possible.free), still, along)])


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


@dataclasses.dataclass(frozen=True, eq=False)
class _Listed:
    """The squares line by line, as steps in a way follow them, and the place of each."""

    order: Int[np.ndarray, "squares"]
    places: Int[np.ndarray, "squares"]

    @classmethod
    def of(cls, order: Int[np.ndarray, "squares"]) -> "_Listed":
        places = np.empty_like(order)
        places[order] = np.arange(order.size)
        return cls(order, places)

    def parts(self) -> Iterator[Int[np.ndarray, "part"]]:
        yield self.order

    def place(self, square: Int[np.ndarray, "some"]) -> Int[np.ndarray, "some"]:
        return self.places[square]


def _walls_of(
    is_free: Bool[np.ndarray, "squares"],
    still: Iterable[Bool[np.ndarray, "*squares"]],
    lines: Sequence[_Listed | GridLines],
) -> _RoomWalls:
    """The walls of one grid.

    **Arguments:**

    - `is_free`: which squares are free.
    - `still`: for each way, whether no step is possible from a square, or it is not free.
    - `lines`: the lines of each way.
    """
    squares: list[np.ndarray] = []
    behind: list[np.ndarray] = []
    places: list[np.ndarray] = []
    for line, ends in zip(lines, still, strict=True):
        found = zip(*_walls_along(line, is_free, ends.ravel()), strict=True)
        for one, parts in zip((places, squares, behind), found, strict=True):
            one.append(np.concatenate(parts))
    start = np.cumsum([0, *map(len, squares)])
    at = np.concatenate(squares)
    after, length = np.empty((2, len(places), at.size), np.int32)
    for w, (line, place) in enumerate(zip(lines, places, strict=True)):
        here = line.place(at)
        # From a free square the next stop is a wall.
        after[w] = np.searchsorted(place, here)
        length[w] = place[after[w]] - here
    return _RoomWalls(start, np.concatenate(behind), after, length)


def _walls_along(
    line: _Listed | GridLines,
    is_free: Bool[np.ndarray, "squares"],
    ends: Bool[np.ndarray, "squares"],
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The places of walls along lines, their squares, and how many squares lead to each."""
    begin = 0
    for order in line.parts():
        # The squares are runs that end in a stop: a wall, or an obstacle.
        stops = np.flatnonzero(ends[order])
        square = order[stops]
        free = is_free[square]
        yield begin + stops[free], square[free], (np.diff(stops, prepend=-1) - 1)[free]
        begin += order.size


@functools.lru_cache(maxsize=16)
def _lines(
    rows: int, columns: int, steps: tuple[tuple[int, int], ...]
) -> list[_Listed] | list[GridLines]:
    """The lines of each offset of a step; those of small grids are listed, to be used again."""
    lines = [GridLines.of(rows, columns, step) for step in steps]
    return [_Listed.of(one.order()) for one in lines] if rows * columns <= _SMALL else lines


def _still(
    free: Bool[np.ndarray, "rows columns"], shape: Stencil
) -> Iterator[Bool[np.ndarray, "rows columns"]]:
    """For each way, whether no step is possible from a square, or the square is not free."""
    rows, columns = free.shape
    margin = int(np.abs(shape.square).max())
    framed = np.pad(free, margin)
    looks = [
        framed[margin + up : margin + up + rows, margin + across : margin + across + columns]
        for up, across in shape.square.tolist()
    ]
    for crossed, beside in zip(shape.crossed, shape.beside, strict=True):
        # Lists of looks are filled up with repeats.
        passes = free.copy()
        for square in dict.fromkeys(crossed.tolist()):
            passes &= looks[square]
        for left, right in dict.fromkeys(map(tuple, beside.tolist())):
            passes &= looks[left] | looks[right]
        yield ~passes
