"""Compute the chords of a room: the straight runs from wall to wall, for each heading."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int

from ..base.shown import Shown
from ..space.copies import copies
from .boundary import Boundary
from .meeting import Met, Pairs, Rows


# The largest width in radians of a group of slices, which is halved down to single slices.
_WIDEST = np.pi / 5


@dataclasses.dataclass(frozen=True, eq=False)
class Chords(Shown):
    """The straight runs from wall to wall, for slices of headings.

    A *slice* is an interval of headings. Each row of the arrays describes the runs from a piece of
    a wall, with the headings of a slice, to one wall. A piece has a row for each wall that a robot
    from there may meet. If headings are known exactly, a piece has only one row.

    A robot that starts at arc length `p` is `clearance[0] + clearance[1] * p` away from the line of
    the wall `hit`, to within `reach`. This distance is at least `sine[0]` and at most `sine[1]`
    times the length of its run. For each end `e` of the slice, the run ends at the arc length
    `arc[e, 0] + arc[e, 1] * p`, to within `spread`.
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
    sine: Float[np.ndarray, "2 rows"]
    "The smallest and largest sine of the angle between a run and the wall `hit`."
    cosine: Float[np.ndarray, "2 rows"]
    "The smallest and largest cosine of this angle, positive toward the end of the wall."
    arc: Float[np.ndarray, "2 2 rows"]
    "The arc length where a run ends: a constant and the factor of `p`, for each end of the slice."
    spread: Float[np.ndarray, "2 rows"]
    "The largest change of `arc` by a start within `reach`, in metres, for each end of the slice."

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
        gap = boundary.tolerance if known else max(0.01, boundary.diameter * width / 8)
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

    @functools.cached_property
    def reach(self) -> Float[np.ndarray, "rows"]:
        """The largest distance between a run and the run that a row states, in metres."""
        bulge = self.boundary.bulge[self.wall] + self.boundary.bulge[self.hit]
        return self.displacement + self.boundary.tolerance + bulge

    @functools.cached_property
    def run(self) -> Float[np.ndarray, "2 rows"]:
        """Bounds of the lengths of the runs of each row in metres, for a quick first test."""
        tolerance, (constant, slope) = self.boundary.tolerance, self.clearance
        away = np.stack([constant + slope * arc for arc in (self.begin, self.end)])
        # Starts may be beside their piece by the tolerance, and rounding by far less.
        slack = self.reach + 4 * tolerance
        with np.errstate(divide="ignore", invalid="ignore"):
            shortest = (away.min(axis=0) - slack) / self.sine[1]
            longest = (away.max(axis=0) + slack) / self.sine[0]
        shortest = np.where(self.sine[1] > 0, shortest, 0.0)
        longest = np.where(self.sine[0] > 0, longest, np.inf)
        return np.stack([shortest - 4 * tolerance, longest + 4 * tolerance])

    @functools.cached_property
    def keys(self) -> tuple[float, Float[np.ndarray, "rows"], Float[np.ndarray, "rows"]]:
        """A length beyond all arc lengths, and the ends of pieces plus `group` times it."""
        size = self.boundary.diameter + 1.0
        return size, self.group * size + self.begin, self.group * size + self.end


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
        low, high = _ends(boundary, rows.slice, level, slices, width)
        if level:
            reach = max(gap, (high - low).max() * boundary.diameter / 4)
            rows, pairs = _cut(rows, pairs, reach)
            low, high = _ends(boundary, rows.slice, level, slices, width)
        pairs = Met.of(boundary, rows, pairs, low, high, displacement).kept(pairs)
        if level == 0:
            break
        rows, pairs, level = *_finer(rows, pairs, level, slices), level - 1
    rows, pairs = _cut_at_corners(boundary, rows, pairs, low, high, displacement, gap)
    low, high = _ends(boundary, rows.slice, 0, slices, width)
    met = Met.of(boundary, rows, pairs, low, high, displacement)
    hit, *bounds = (part[..., met.keep] for part in (pairs.wall, *met[1:]))
    return *rows.take(pairs.row[met.keep]), hit, *bounds


def _ends(
    boundary: Boundary, group: Int[np.ndarray, "rows"], level: int, slices: int, width: float
) -> tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "rows"]]:
    """Compute the least and the largest heading of groups of `2**level` slices, in radians.

    They are moved outward, so that rounding loses no heading.
    """
    turn, over = 2 * np.pi / slices, boundary.tolerance / boundary.diameter
    first = group << level
    last = np.minimum(first + (1 << level), slices) - 1
    return first * turn - over, last * turn + width + over


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
    displacement: float,
    gap: float,
) -> tuple[Rows, Pairs]:
    """Cut pieces where a ray with the least or largest heading, `low` or `high`, passes a corner.

    Cuts are moved away from the places from which some rays may touch the corner. No new piece is
    shorter than `gap` metres.
    """
    from_ = rows.wall[pairs.row]
    at, tangent = boundary.begin[from_], boundary.tangent[from_]
    beside = displacement + 5 * boundary.tolerance + boundary.bulge[from_]
    aheads = [np.stack([np.cos(h), np.sin(h)], axis=1)[pairs.row] for h in (low, high)]
    across = np.stack([_cross(tangent, ahead) for ahead in aheads])
    # If the slice has a heading along the wall, the places lie outside of the two cuts.
    outward = beside * np.sign(across[0] * across[1])
    cuts = []
    for wall in (pairs.wall, boundary.following[pairs.wall]):
        to = boundary.begin[wall] - at
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([_cross(to, ahead) for ahead in aheads]) / across
            away = outward / np.abs(across)
        least = ends[0] <= ends[1]
        cuts += [ends[0] + np.where(least, -away[0], away[0])]
        cuts += [ends[1] + np.where(least, away[1], -away[1])]
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
    return rows.take(source)._replace(begin=begin, end=end), pairs.copied(source, number.size)


def _cross(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
