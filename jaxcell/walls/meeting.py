"""Find the walls that robots may meet after they leave a piece of a wall."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..space.copies import copies
from .boundary import Boundary


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
    sine: Float[np.ndarray, "2 pairs"]
    cosine: Float[np.ndarray, "2 pairs"]
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
    ) -> "Met":
        """Bound the runs of each pair, from a piece of a wall with headings of a slice, to a wall.

        Distance and arc length are monotone in the place and in the heading, so their extremes are
        on four rays: from both ends of the piece, with the headings `low` and `high` in radians. A
        wall is not kept if none of these four rays leads to it, or if nearer walls block every ray.
        Both are decided for all starts within the displacement, the tolerance and the bulge of the
        arc of their place. A ray that touches a corner continues, unless the corner is convex.
        """
        row, wall = pairs
        from_ = rows.wall[row]
        normal, tangent, lean = boundary.normal[wall], boundary.tangent[wall], boundary.lean[wall]
        offset = boundary.begin[from_] - boundary.begin[wall]
        along = boundary.tangent[from_]
        clearance = np.stack([_dot(offset, normal), _dot(along, normal)])
        beside = np.stack([_dot(offset, tangent), _dot(along, tangent)])
        own = wall == from_
        # A robot at a wall that it faces bumps into it at once.
        at_once = own & (displacement == 0)
        clearance[:, own] = 0.0
        aheads = [np.stack([np.cos(h), np.sin(h)], axis=1)[row] for h in (low, high)]
        facing = np.stack([-_dot(ahead, normal) for ahead in aheads])
        aside = np.stack([_dot(ahead, tangent) for ahead in aheads])
        sure = facing > lean
        ratio = 1 / np.where(sure, facing, 1.0)
        # A ray that is nearly parallel to a wall meets its line far away.
        endless = np.copysign(np.inf, aside)
        arc = np.stack(
            [
                np.where(sure, beside[0] + clearance[0] * aside * ratio, endless),
                np.where(sure, beside[1] + clearance[1] * aside * ratio, 0.0),
            ],
            axis=1,
        )
        begin, end = rows.begin[row], rows.end[row]
        along_it = np.flatnonzero(~sure.any(axis=0))
        arc[:, :, along_it] = _first_touched(
            boundary,
            wall[along_it],
            beside[:, along_it],
            aside[0, along_it] > 0,
            begin[along_it],
            end[along_it],
        )
        arc[:, :, at_once] = beside[:, at_once]
        ratio[:, at_once] = 1.0
        inner = displacement + boundary.tolerance + boundary.bulge[from_]
        reach = inner + boundary.bulge[wall]
        spread = reach * ratio
        head_on = sure.any(axis=0) & (aside[0] * aside[1] <= 0)
        sine = np.stack(
            [
                np.maximum(facing.min(axis=0), -lean),
                np.where(head_on, 1.0, np.maximum(facing.max(axis=0), -lean)),
            ]
        )
        sine[:, at_once] = 1.0
        parallel = ~sure.all(axis=0)
        cosine = np.stack([aside.min(axis=0), aside.max(axis=0)])
        cosine[0, parallel & (cosine[0] < 0)] = -1.0
        cosine[1, parallel & (cosine[1] > 0)] = 1.0
        near, far = clearance[0] + clearance[1] * begin, clearance[0] + clearance[1] * end
        lowest, highest = np.minimum(near, far), np.maximum(near, far)
        farthest = _farthest_corner(boundary, rows, pairs) + reach
        places = np.stack([arc[:, 0] + arc[:, 1] * begin, arc[:, 0] + arc[:, 1] * end])
        length = boundary.length[wall]
        keep = (facing > -lean).any(axis=0)
        keep &= highest >= farthest * np.minimum(sine[0], 0.0) - reach
        keep &= ((places - spread).min(axis=(0, 1)) <= length) | at_once
        keep &= ((places + spread).max(axis=(0, 1)) >= 0) | at_once
        met = cls(keep, clearance, sine, cosine, arc, spread)
        # A ray that passes a convex corner on the wrong side meets the other wall of the corner.
        inside = inner * ratio
        outside = (displacement - 8 * (inner - displacement)) * ratio
        after = boundary.following[wall]
        first = (places - np.where(boundary.convex[wall], outside, inside)).min(axis=(0, 1)) >= 0
        last = (places + np.where(boundary.convex[after], outside, inside)).max(axis=(0, 1))
        # The free space near a convex corner lies in front of both of its walls.
        front = (
            (lowest >= inner) | own | (boundary.preceding[wall] == from_) & boundary.convex[wall]
        )
        front |= (after == from_) & boundary.convex[from_]
        whole = keep & sure.all(axis=0) & front
        first = whole & (first | at_once)
        last = whole & ((last <= length) | at_once)
        least = np.maximum(lowest - reach, 0.0) / np.maximum(sine[1], lean)
        most = (highest + reach) / np.where(whole, sine[0], 1.0)
        blocked = _shortest_blocked(boundary, pairs, whole, first, last, np.minimum(most, farthest))
        hidden = least > blocked
        hidden |= _behind(boundary, pairs, first & last, met, near, far, facing, inner)
        stays = np.zeros(low.size, bool)
        stays[row[at_once & whole]] = True
        hidden |= stays[row] & ~own
        return met._replace(keep=keep & ~hidden)


def _dot(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def _first_touched(
    boundary: Boundary,
    wall: Int[np.ndarray, "pairs"],
    beside: Float[np.ndarray, "2 pairs"],
    forward: Bool[np.ndarray, "pairs"],
    begin: Float[np.ndarray, "pairs"],
    end: Float[np.ndarray, "pairs"],
) -> Float[np.ndarray, "2 2 pairs"]:
    """Bound the arc length at which rays that are parallel to a wall first touch it.

    A ray that starts beside the wall touches it there, and another ray at its nearer corner. Rays
    run `forward`, from the start of the wall to its end, or backward. A ray may touch an arc
    anywhere.
    """
    corner = np.where(forward, 0.0, boundary.length[wall])
    ends = np.stack([beside[0] + beside[1] * begin, beside[0] + beside[1] * end])
    before = (ends < corner) == forward
    touched = np.stack([corner, np.zeros(wall.size)])
    arc = np.stack(
        [
            np.where(before.all(axis=0), touched, beside),
            np.where(before.any(axis=0), touched, beside),
        ]
    )
    round_ = boundary.bulge[wall] > 0
    arc[:, 0, round_], arc[:, 1, round_] = np.array([[-np.inf], [np.inf]]), 0.0
    return arc


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
    boundary: Boundary,
    pairs: Pairs,
    blocks: Bool[np.ndarray, "pairs"],
    met: Met,
    near: Float[np.ndarray, "pairs"],
    far: Float[np.ndarray, "pairs"],
    facing: Float[np.ndarray, "2 pairs"],
    inner: Float[np.ndarray, "pairs"],
) -> Bool[np.ndarray, "pairs"]:
    """Check for each pair whether another wall, which blocks the row, is nearer on every ray.

    `blocks` marks the pairs whose wall alone blocks the row, `near` and `far` are the clearances of
    the two ends of the piece, and `inner` is the largest distance from a place to a start. The sign
    of a function tells which wall is nearer on a ray. The function is linear in the place. For a
    heading in the slice, it is a nonnegative combination of the values at both ends. So it is
    enough to check four rays: from both ends of the piece, with the headings at both ends of the
    slice.
    """
    row, wall = pairs
    behind = np.zeros(row.size, bool)
    at = np.flatnonzero(blocks)
    if not at.size:
        return behind
    middle = (near + far)[at] / met.sine.sum(axis=0)[at]
    order = at[np.lexsort((middle, row[at]))]
    nearest = np.full(row[-1] + 1, -1)
    nearest[row[order[::-1]]] = order[::-1]
    own = nearest[row]
    pair = np.flatnonzero((own >= 0) & (own != np.arange(row.size)))
    other = own[pair]
    (ax, ay), (bx, by) = boundary.tangent[wall[pair]].T, boundary.tangent[wall[other]].T
    crossed = np.abs(ax * by - ay * bx)
    # The true walls may be nearer or farther than their chords by the tolerance, and arcs nearer.
    rounding = 2 * boundary.tolerance
    nearer = rounding + boundary.bulge[wall[pair]]
    margins = [
        (clear[pair] - nearer) * sine[other]
        - (clear[other] + rounding) * np.maximum(sine[pair], boundary.lean[wall[pair]])
        for clear in (near, far)
        for sine in facing
    ]
    behind[pair] = (np.stack(margins) > inner[pair] * crossed).all(axis=0)
    return behind
