"""Find the walls that robots may meet after they leave a piece of a wall."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..space.copies import copies
from .boundary import ROUNDING, Boundary


class Rows(NamedTuple):
    """Pieces of walls that robots leave, each with a slice of headings."""

    slice: Int[np.ndarray, "rows"]
    wall: Int[np.ndarray, "rows"]
    begin: Float[np.ndarray, "rows"]
    end: Float[np.ndarray, "rows"]

    def take(self, row: Int[np.ndarray, "taken"]) -> "Rows":
        return Rows(*(part[row] for part in self))


class Pairs(NamedTuple):
    """Pairs of a row of `Rows` and a wall that its robots may hit, sorted by row and wall."""

    row: Int[np.ndarray, "pairs"]
    wall: Int[np.ndarray, "pairs"]

    def copied(self, source: Int[np.ndarray, "rows"], rows: int) -> "Pairs":
        """Copy pairs of `rows` rows to new rows: new row `k` gets the walls of row `source[k]`."""
        first = np.searchsorted(self.row, np.arange(rows + 1))
        new, number = copies(np.diff(first)[source])
        return Pairs(new, self.wall[first[source][new] + number])


class Met(NamedTuple):
    """Bounds of the runs from each row to each wall, as in [`Chords`][jaxcell.walls.Chords]."""

    keep: Bool[np.ndarray, "pairs"]
    "True if a run from the row to the wall may be possible."
    clearance: Float[np.ndarray, "2 pairs"]
    stretch: Float[np.ndarray, "2 pairs"]
    arc: Float[np.ndarray, "2 2 pairs"]
    spread: Float[np.ndarray, "2 pairs"]

    def kept(self, pairs: Pairs) -> Pairs:
        return Pairs(pairs.row[self.keep], pairs.wall[self.keep])

    @classmethod
    def of(
        cls,
        boundary: Boundary,
        rows: Rows,
        pairs: Pairs,
        low: Float[np.ndarray, "rows"],
        high: Float[np.ndarray, "rows"],
        displacement: float,
        *,
        apart: bool = False,
    ) -> "Met":
        """Bound the runs of each pair, from a piece of a wall with headings of a slice, to a wall.

        Distance and arc length are monotone in the place and in the heading, so their extremes are
        on four rays: from both ends of the piece, with the headings `low` and `high` in radians. A
        wall is not kept if none of these four rays leads to it, or if nearer walls block every ray.
        A ray that only touches a corner continues. With `apart`, rays from the ends of a piece that
        only touch a corner are ignored, because the ends have rows of their own.
        """
        row, wall = pairs
        from_ = rows.wall[row]
        normal, tangent = boundary.normal[wall], boundary.tangent[wall]
        offset = boundary.begin[from_] - boundary.begin[wall]
        along = boundary.tangent[from_]
        clearance = np.stack([_dot(offset, normal), _dot(along, normal)])
        beside = np.stack([_dot(offset, tangent), _dot(along, tangent)])
        own = wall == from_
        clearance[:, own] = 0.0
        begin, end = rows.begin[row], rows.end[row]
        facing, aside = np.empty((2, row.size)), np.empty((2, row.size))
        arc = np.empty((2, 2, row.size))
        for side, heading in enumerate((low, high)):
            ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)[row]
            facing[side] = -_dot(ahead, normal)
            aside[side] = _dot(ahead, tangent)
            # A ray that does not face the wall meets the line of the wall at infinity.
            meets = facing[side] > 1e-12
            ratio = aside[side] / np.where(meets, facing[side], 1.0)
            endless = np.copysign(np.inf, aside[side])
            arc[side] = np.where(
                meets, beside + clearance * ratio, np.stack([endless, np.zeros(row.size)])
            )
            if not displacement:
                arc[side][:, own] = beside[:, own]
        sure = facing > 1e-12
        head_on = sure.all(axis=0) & (aside[0] * aside[1] <= 0)
        with np.errstate(divide="ignore"):
            ratio = np.where(sure, 1 / facing, np.inf)
        if not displacement:
            ratio[:, own] = 1.0
        stretch = np.stack([np.where(head_on, 1.0, ratio.min(axis=0)), ratio.max(axis=0)])
        spread = displacement * np.where(sure, ratio, 0.0)
        near, far = clearance[0] + clearance[1] * begin, clearance[0] + clearance[1] * end
        places = np.stack([arc[:, 0] + arc[:, 1] * begin, arc[:, 0] + arc[:, 1] * end])
        lowest = (places - spread).min(axis=(0, 1))
        highest = (places + spread).max(axis=(0, 1))
        length = boundary.length[wall]
        keep = sure.any(axis=0) & (np.maximum(near, far) >= -ROUNDING - displacement)
        keep &= (lowest <= length + ROUNDING) & (highest >= -ROUNDING)
        # A robot that heads along its wall may bump into it at once.
        keep |= own & (np.abs(facing) <= 1e-9).any(axis=0)
        met = cls(keep, clearance, stretch, arc, spread)
        front = np.minimum(near, far) - displacement >= -ROUNDING
        whole = keep & sure.all(axis=0) & front
        # A ray that only touches a corner continues if free space lies on the other side.
        before, after = boundary.preceding[wall], boundary.following[wall]
        ahead = np.stack([np.cos(low), np.sin(low)], axis=1)[row]
        grazes = [
            (_dot(tangent, boundary.normal[before]) <= 0)
            & (_dot(ahead, boundary.normal[before]) > -ROUNDING),
            (_dot(boundary.tangent[after], normal) <= 0)
            & (_dot(ahead, boundary.normal[after]) > -ROUNDING),
        ]
        touched = (highest, lowest) if apart else (lowest, highest)
        first = whole & (lowest >= -ROUNDING) & ~(grazes[0] & (touched[0] <= ROUNDING))
        last = whole & (highest <= length + ROUNDING)
        last &= ~(grazes[1] & (touched[1] >= length - ROUNDING))
        least = _times(np.maximum(np.minimum(near, far) - displacement, 0.0), stretch[0])
        most = _times(np.maximum(near, far) + displacement, stretch[1])
        most = np.minimum(most, _farthest_corner(boundary, rows, pairs) + displacement)
        hidden = least > _shortest_blocked(boundary, pairs, whole, first, last, most) + 1e-9
        hidden |= _behind(pairs, first & last, np.stack([near, far]), facing, tangent, displacement)
        return met._replace(keep=keep & ~hidden)


def _dot(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def _times(distance: Float[np.ndarray, "n"], ratio: Float[np.ndarray, "n"]) -> np.ndarray:
    """Multiply distances by ratios; 0 times infinity is 0."""
    return np.where(distance > 0, distance * np.where(distance > 0, ratio, 1.0), 0.0)


def _farthest_corner(boundary: Boundary, rows: Rows, pairs: Pairs) -> Float[np.ndarray, "pairs"]:
    """Compute the largest distance between points of the piece and the wall of each pair."""
    row, wall = pairs
    ends = [boundary.point(rows.wall, arc)[row] for arc in (rows.begin, rows.end)]
    corners = boundary.begin[wall], boundary.begin[boundary.following[wall]]
    apart = [np.hypot(*(end - corner).T) for end in ends for corner in corners]
    return np.max(apart, axis=0)


def _shortest_blocked(
    boundary: Boundary,
    pairs: Pairs,
    whole: Bool[np.ndarray, "pairs"],
    first: Bool[np.ndarray, "pairs"],
    last: Bool[np.ndarray, "pairs"],
    most: Float[np.ndarray, "pairs"],
) -> Float[np.ndarray, "pairs"]:
    """Compute, for each pair, a distance in metres beyond which walls block every ray of its row.

    A chain of consecutive walls blocks all rays of a row if every wall faces the rays (`whole`), no
    ray passes before the start of the first wall (`first`), and no ray passes after the end of the
    last wall (`last`). `most` is the largest length of a ray to each wall. The distance is infinite
    if no chain blocks the row.
    """
    row, wall = pairs
    linked = np.r_[False, row[1:] == row[:-1]]
    linked &= np.r_[False, boundary.following[wall[:-1]] == wall[1:]]
    linked &= whole & np.r_[False, whole[:-1]]
    number = np.arange(row.size)
    chain = np.maximum.accumulate(np.where(linked, 0, number))
    begin = np.maximum.accumulate(np.where(first, number, -1))
    ends = np.flatnonzero(last & (begin >= chain))
    blocked = np.full(row[-1] + 1 if row.size else 0, np.inf)
    if ends.size:
        bounds = np.stack([begin[ends], ends + 1], axis=1).ravel()
        farthest = np.maximum.reduceat(np.r_[most, 0.0], bounds)[::2]
        np.minimum.at(blocked, row[ends], farthest)
    return blocked[row]


def _behind(
    pairs: Pairs,
    blocks: Bool[np.ndarray, "pairs"],
    clearance: Float[np.ndarray, "2 pairs"],
    facing: Float[np.ndarray, "2 pairs"],
    tangent: Float[np.ndarray, "pairs 2"],
    displacement: float,
) -> Bool[np.ndarray, "pairs"]:
    """Check for each pair whether another wall, which blocks the row, is nearer on every ray.

    `blocks` marks the pairs whose wall alone blocks the row. The sign of a function tells which
    wall is nearer on a ray. The function is linear in the place. For a heading in the slice, it is
    a nonnegative combination of the values at both ends. So it is enough to check four rays: from
    both ends of the piece, with the headings at both ends of the slice.
    """
    row, _ = pairs
    behind = np.zeros(row.size, bool)
    at = np.flatnonzero(blocks)
    if not at.size:
        return behind
    middle = (clearance[0] + clearance[1])[at] / (facing[0] + facing[1])[at]
    order = at[np.lexsort((middle, row[at]))]
    nearest = np.full(row[-1] + 1, -1)
    nearest[row[order[::-1]]] = order[::-1]
    own = nearest[row]
    pair = np.flatnonzero((own >= 0) & (own != np.arange(row.size)))
    other = own[pair]
    crossed = np.abs(tangent[pair, 0] * tangent[other, 1] - tangent[pair, 1] * tangent[other, 0])
    margins = [
        clearance[i, pair] * facing[j, other] - clearance[i, other] * facing[j, pair]
        for i in (0, 1)
        for j in (0, 1)
    ]
    margin = np.stack(margins) - displacement * crossed
    behind[pair] = (margin >= -ROUNDING).all(axis=0) & (margin > ROUNDING).any(axis=0)
    return behind
