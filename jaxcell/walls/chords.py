"""Compute the chords of a room: the straight runs from wall to wall, for each heading."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int

from ..space.copies import copies
from .boundary import Boundary
from .meeting import Met, Pairs, Rows


# The largest width in radians of a group of slices, which is halved down to single slices.
_WIDEST = np.pi / 5
# The angle by which slices overlap, so that rounding loses no heading between them, in radians.
_OVERLAP = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Chords:
    """The straight runs from wall to wall, for slices of headings.

    A *slice* is an interval of headings. Each row of the arrays describes the runs from a piece of
    a wall, with the headings of a slice, to one wall. A piece has a row for each wall that a robot
    from there may meet. If headings are known exactly, a piece has only one row.

    A robot that starts at arc length `p` is `clearance[0] + clearance[1] * p` away from the line of
    the wall `hit`. The length of its run is at least `stretch[0]` and at most `stretch[1]` times
    this distance. For each end `e` of the slice, the run ends at the arc length
    `arc[e, 0] + arc[e, 1] * p`.
    """

    boundary: Boundary
    slices: int
    "The number of slices of headings; slice k begins at the heading `2 pi k / slices`."
    width: float
    "The width of a slice in radians; 0 for headings that are known exactly."
    displacement: float
    "The largest distance from a bump to the start of the next run, in metres."
    slice: Int[np.ndarray, "rows"]
    wall: Int[np.ndarray, "rows"]
    begin: Float[np.ndarray, "rows"]
    "The arc length on the wall where the piece begins, in metres."
    end: Float[np.ndarray, "rows"]
    hit: Int[np.ndarray, "rows"]
    "The index of the wall at which the runs end."
    clearance: Float[np.ndarray, "2 rows"]
    "The distance from a start to the line of the wall `hit`: a constant and the factor of `p`."
    stretch: Float[np.ndarray, "2 rows"]
    "The smallest and largest ratio of the length of a run to the distance that `clearance` gives."
    arc: Float[np.ndarray, "2 2 rows"]
    "The arc length where a run ends: a constant and the factor of `p`, for each end of the slice."
    spread: Float[np.ndarray, "2 rows"]
    "The largest change of `arc` that `displacement` causes, in metres, for each end of the slice."

    @classmethod
    def of(
        cls, boundary: Boundary, slices: int, *, known: bool, displacement: float = 0.0
    ) -> "Chords":
        """Find the runs from all walls with all headings.

        If headings are `known`, they are exactly the multiples of `2 pi / slices`. Otherwise a row
        holds for all headings of its slice. `displacement` is in metres.
        """
        turn = 2 * np.pi / slices
        width = 0.0 if known else turn
        # The least length of a piece: those of known headings are cut wherever the next wall
        # changes.
        gap = 1e-9 if known else max(0.01, boundary.diameter * width / 8)
        level = max(0, int(np.log2(max(1.0, _WIDEST / turn))))
        # The groups are followed one by one, so that their arrays stay in the processor's cache.
        parts = [
            _runs_in_group(boundary, group, level, slices, width, displacement, gap)
            for group in range(-(-slices // 2**level))
        ]
        arrays = (np.concatenate(of_groups, axis=-1) for of_groups in zip(*parts, strict=True))
        return cls(boundary, slices, width, displacement, *arrays)

    @functools.cached_property
    def group(self) -> Int[np.ndarray, "rows"]:
        """A number that combines the slice and the wall of each row; rows are sorted by it."""
        return self.slice.astype(np.int64) * len(self.boundary.length) + self.wall


def _runs_in_group(
    boundary: Boundary,
    group: int,
    level: int,
    slices: int,
    width: float,
    displacement: float,
    gap: float,
) -> tuple[np.ndarray, ...]:
    """Find the runs from all walls with the headings of a group of `2**level` slices.

    Pieces have at least `gap` metres. Returns the arrays of [`Chords`][], in the order of fields.
    """
    walls = np.arange(len(boundary.length))
    rows = Rows(np.full(walls.size, group), walls, np.zeros(walls.size), boundary.length)
    pairs = Pairs(np.repeat(walls, walls.size), np.tile(walls, walls.size))
    while True:
        low, high = _ends(rows.slice, level, slices, width)
        if level:
            reach = max(gap, (high - low).max() * boundary.diameter / 4)
            rows, pairs = _cut(rows, pairs, reach)
            low, high = _ends(rows.slice, level, slices, width)
        pairs = Met.of(boundary, rows, pairs, low, high, displacement).kept(pairs)
        if level == 0:
            break
        rows, pairs, level = *_finer(rows, pairs, level, slices), level - 1
    rows, pairs = _cut_at_corners(boundary, rows, pairs, low, high, gap)
    low, high = _ends(rows.slice, 0, slices, width)
    met = Met.of(boundary, rows, pairs, low, high, displacement, apart=True)
    hit, *bounds = (part[..., met.keep] for part in (pairs.wall, *met[1:]))
    return *rows.take(pairs.row[met.keep]), hit, *bounds


def _ends(
    group: Int[np.ndarray, "rows"], level: int, slices: int, width: float
) -> tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "rows"]]:
    """Compute the least and the largest heading of groups of `2**level` slices, in radians."""
    turn = 2 * np.pi / slices
    first = group << level
    last = np.minimum(first + (1 << level), slices) - 1
    if width == 0:
        over = _OVERLAP if level else 0.0
        return first * turn - over, last * turn + over
    return first * turn - _OVERLAP, (last + 1) * turn + _OVERLAP


def _finer(rows: Rows, pairs: Pairs, level: int, slices: int) -> tuple[Rows, Pairs]:
    """Split each group of `2**level` slices in two, with its rows, and the pairs (row, wall)."""
    group = (rows.slice[:, None] * 2 + np.arange(2)).ravel()
    source = np.repeat(np.arange(rows.slice.size), 2)
    there = (group << (level - 1)) < slices
    group, source = group[there], source[there]
    finer = rows.take(source)._replace(slice=group)
    order = np.lexsort((finer.begin, finer.wall, finer.slice))
    return finer.take(order), pairs.copied(source[order], rows.slice.size)


def _cut(rows: Rows, pairs: Pairs, longest: float) -> tuple[Rows, Pairs]:
    """Cut pieces of walls into equal parts of at most `longest` metres."""
    parts = np.maximum(1, np.ceil((rows.end - rows.begin) / longest)).astype(int)
    source, number = copies(parts)
    cut = rows.take(source)
    length = (cut.end - cut.begin) / parts[source]
    begin = cut.begin + number * length
    end = np.where(number + 1 == parts[source], cut.end, begin + length)
    return cut._replace(begin=begin, end=end), pairs.copied(source, parts.size)


def _cut_at_corners(
    boundary: Boundary,
    rows: Rows,
    pairs: Pairs,
    low: Float[np.ndarray, "rows"],
    high: Float[np.ndarray, "rows"],
    gap: float,
) -> tuple[Rows, Pairs]:
    """Cut pieces where a ray with the least or largest heading, `low` or `high`, passes a corner.

    No new piece is shorter than `gap` metres.
    """
    at, wall = boundary.begin[rows.wall[pairs.row]], rows.wall[pairs.row]
    corners = boundary.begin[pairs.wall], boundary.begin[boundary.following[pairs.wall]]
    cuts = []
    for heading in (low, high)[: 1 if np.array_equal(low, high) else 2]:
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)[pairs.row]
        tangent = boundary.tangent[wall]
        across = tangent[:, 0] * ahead[:, 1] - tangent[:, 1] * ahead[:, 0]
        for corner in corners:
            to = corner - at
            with np.errstate(divide="ignore", invalid="ignore"):
                cuts.append((to[:, 0] * ahead[:, 1] - to[:, 1] * ahead[:, 0]) / across)
    place = np.stack(cuts, axis=1)
    inside = (place > rows.begin[pairs.row, None] + gap) & (place < rows.end[pairs.row, None] - gap)
    pair, column = np.nonzero(inside)
    number = np.arange(rows.slice.size)
    source = np.concatenate([number, pairs.row[pair]])
    begin = np.concatenate([rows.begin, place[pair, column]])
    order = np.lexsort((begin, source))
    source, begin = source[order], begin[order]
    # Of cuts that are closer together than the gap, only the first counts.
    while True:
        near = np.r_[False, (np.diff(begin) < gap) & (np.diff(source) == 0)]
        near &= ~np.r_[False, near[:-1]]
        if not near.any():
            break
        source, begin = source[~near], begin[~near]
    last = np.r_[source[1:] != source[:-1], True]
    end = np.where(last, rows.end[source], np.r_[begin[1:], 0.0])
    if np.array_equal(low, high):
        # From the cut itself, a ray may pass between two corners that the rays on both sides hit.
        source, begin = np.repeat(source, 2), np.repeat(begin, 2)
        end = np.stack([begin[::2], end], axis=1).ravel()
    return rows.take(source)._replace(begin=begin, end=end), pairs.copied(source, number.size)
