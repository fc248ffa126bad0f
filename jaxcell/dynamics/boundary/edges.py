import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from ...base.shown import Shown
from ...space.box import Box
from ..basin import Basins
from ..cycles import newton
from ..imaging import Say
from ..maps import Map
from ..orbits import attractor_owners, orbit_ends


# Largest number of pairs of basins, starts on the boundary of each, and followed points at a time.
_MAX_PAIRS = 32
_STARTS = 3
_POINTS = 1 << 10
# Powers of the precision: the distances of two orbits, in lengths of the box, at which a round
# begins and ends, and the largest numbers of mappings of a round and of rounds.
_NARROW, _WIDE = 0.75, 0.45
_ROUND = 256
_ROUNDS = 8
# Periods of an edge state for Newton's method, and the distances in cells, after a period, of an
# orbit that has settled and of its refined point.
_PERIODS = range(1, 9)
_SETTLED, _MOVED = 1e-3, 1e-1
# Distance in cells below which two edge states are the same.
_SAME = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class EdgeStates(Shown):
    """Edge states: saddles on boundaries of basins, which attract the orbits on the boundary."""

    first: Int[np.ndarray, "edges"]
    "The attractor on one side of each edge state, the one with the smaller number."
    second: Int[np.ndarray, "edges"]
    "The attractor on the other side of each edge state."
    point: Float[np.ndarray, "edges axes"]
    "A point of each edge state."
    period: Int[np.ndarray, "edges"]
    "The period in mappings, from 1 to 8; 0 for other states, such as chaos or a cycle of a flow."
    multipliers: Complex[np.ndarray, "edges axes"]
    "Eigenvalues of the map's derivative over one period, the largest first; NaN if `period` is 0."
    orbit: Float[np.ndarray, "edges window axes"]
    "Successive points of an orbit near each edge state, padded with NaN."

    @property
    def unstable(self) -> Int[np.ndarray, "edges"]:
        """Number of unstable directions of each edge state, or -1 if the state has no period."""
        count = np.count_nonzero(np.abs(self.multipliers) > 1, axis=1)
        return np.where(self.period > 0, count, -1)


def edge_states(map: Map, basins: Basins, *, say: Say | None = None) -> EdgeStates:
    """Find the edge states between basins: saddles that attract the orbits on a boundary.

    A segment between neighbouring cells of two basins is bisected until its ends are nearly equal
    and still lead to different attractors. Both ends are mapped until they have separated, and the
    segment between them is bisected again. So the pair of points follows the boundary to the edge
    state (Skufca, Yorke & Eckhardt 2006). Newton's method then refines fixed points and cycles of
    points. A transition between attractors by weak noise passes near an edge state with one
    unstable direction.

    **Arguments:** a map, its basins, and a function that is called with the progress. **Returns:**
    the edge states. At most 32 pairs of neighbouring basins are searched, each from three places on
    their common boundary.

    The middle of a double well, between the attractors -1 and 1:

        >>> from jaxcell import dynamics, space
        >>> def well(x, p):
        ...     return x + 0.3 * (x - x**3)
        >>> basins = dynamics.basins(well, space.Box([-2], [2], cells=[21]))
        >>> edges = dynamics.edge_states(well, basins)
        >>> abs(edges.point.round(3)).tolist(), edges.multipliers.real.round(2).tolist()
        ([[0.0]], [[1.3]])
    """
    box = basins.box
    ends = _starts(basins)
    owner = attractor_owners(box, basins.attractor_cells)
    kind = jnp.zeros(()).dtype
    narrow, wide = (float(jnp.finfo(kind).eps) ** power for power in (_NARROW, _WIDE))
    params = jax.tree.map(jnp.asarray, basins.params)

    def label(points: Float[np.ndarray, "... axes"]) -> Int[np.ndarray, "..."]:
        flat = points.reshape(-1, box.dimensions).astype(kind)
        reached, _ = orbit_ends(map, box, basins.params, owner, flat, follow=basins.follow)
        return reached.reshape(points.shape[:-1])

    labels = label(ends) if len(ends) else np.zeros((0, 2), int)
    differ = (labels[:, 0] != labels[:, 1]) & (labels >= 0).all(axis=1)
    ends, labels = ends[differ], labels[differ]
    orbit = np.zeros((len(ends), _ROUND, box.dimensions))
    for k in range(_ROUNDS if len(ends) else 0):
        ends, labels = _cut(box, ends, labels, label, narrow)
        orbit, ends = (np.asarray(x) for x in _track(map, box, params, ends.astype(kind), wide))
        if say is not None:
            say("following boundaries", k + 1, _ROUNDS)
        if (np.min([_returns(box, orbit, k)[1] for k in _PERIODS], axis=0) < _SETTLED).all():
            break
    point, period, multipliers = _refined(map, params, box, orbit)
    labels = np.sort(labels, axis=1)
    kept = _different(box, labels, orbit)
    first, second = labels[kept].T
    state = point[kept], period[kept], multipliers[kept]
    return EdgeStates(first, second, *state, orbit[kept].astype(float))


def _starts(basins: Basins) -> Float[np.ndarray, "starts 2 axes"]:
    """Choose pairs of points on opposite sides of boundaries, a few for each pair of basins."""
    box, count = basins.box, basins.attractors
    grid = basins.basin.reshape(box.cells)
    cells, pairs, steps = [], [], []
    for axis, kind in enumerate(box.axes):
        after = np.roll(grid, -1, axis)
        differs = (grid != after) & (grid >= 0) & (after >= 0)
        if kind != "periodic":
            differs[(slice(None),) * axis + (slice(-1, None),)] = False
        here = np.flatnonzero(differs)
        both = np.sort([grid.ravel()[here], after.ravel()[here]], axis=0)
        cells.append(here)
        pairs.append(both[0] * count + both[1])
        steps.append(np.full(here.size, axis))
    cell, pair, step = (np.concatenate(each) for each in (cells, pairs, steps))
    chosen = []
    for name in np.unique(pair)[:_MAX_PAIRS]:
        own = np.flatnonzero(pair == name)
        chosen.append(own[np.arange(_STARTS) * own.size // _STARTS])
    rows = np.unique(np.concatenate([np.empty(0, int), *chosen]))
    along = np.eye(box.dimensions)[step[rows]] * box.width
    # One cell farther, because the centre of a cell on the boundary may lead to no attractor.
    return np.stack([box.centre(cell[rows]) + k * along for k in (-1, 2)], axis=1)


def _cut(
    box: Box,
    ends: Float[np.ndarray, "pairs 2 axes"],
    labels: Int[np.ndarray, "pairs 2"],
    label: Any,
    narrow: float,
) -> tuple[Float[np.ndarray, "pairs 2 axes"], Int[np.ndarray, "pairs 2"]]:
    """Shorten segments to `narrow` box lengths, with ends that still lead to different attractors.

    `labels` are the attractors to which the ends lead, and `label(points)` finds attractors.
    """
    rows, size = np.arange(len(ends)), np.array(box.upper) - np.array(box.lower)
    parts = max(2, _POINTS // len(ends))
    place = np.linspace(0, 1, parts + 1)[:, None]
    ends = ends.astype(float)
    while (np.abs(ends[:, 1] - ends[:, 0]) / size).max() > narrow:
        points = ends[:, :1] + place * (ends[:, 1:] - ends[:, :1])
        reached = label(points)
        reached[:, 0], reached[:, -1] = labels[:, 0], labels[:, 1]
        before, after = reached[:, :-1], reached[:, 1:]
        changes = before != after
        # A change between the same two attractors is preferred to other changes.
        same = changes & np.isin(before, labels) & np.isin(after, labels)
        changes = np.where(same.any(axis=1, keepdims=True), same, changes)
        at = changes.argmax(axis=1)
        new = np.stack([points[rows, at], points[rows, at + 1]], axis=1)
        labels = np.stack([before[rows, at], after[rows, at]], axis=1)
        if (new == ends).all():
            break
        ends = new
    return ends, labels


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _track(map: Map, box: Box, params: Any, ends: Any, wide: Any) -> Any:
    """Map ends of segments until they are `wide` box lengths apart; return midpoints and ends."""
    size = jnp.asarray(np.array(box.upper) - np.array(box.lower), ends.dtype)

    def track(pair):  # type: ignore[no-untyped-def]
        def step(k, state):  # type: ignore[no-untyped-def]
            pair, orbit = state
            near = jnp.max(jnp.abs(pair[1] - pair[0]) / size) < wide
            orbit = orbit.at[k].set(jnp.where(near, jnp.mean(pair, axis=0), jnp.nan))
            new = jax.vmap(lambda x: map(x, params))(pair)
            # Both are moved by the same number of turns round a periodic axis.
            turns = box.wrapped(new[0]) - new[0]
            return jnp.where(near, new + turns[None], pair), orbit

        orbit = jnp.zeros((_ROUND, pair.shape[1]), pair.dtype)
        return jax.lax.fori_loop(0, _ROUND, step, (pair, orbit))

    ends, orbit = jax.vmap(track)(ends)
    return orbit, ends


def _refined(
    map: Map, params: Any, box: Box, orbit: Float[np.ndarray, "states window axes"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Refine a point on each orbit by Newton's method; return points, periods and multipliers."""
    point, period = orbit[:, 0].astype(float), np.zeros(len(orbit), np.int64)
    multipliers = np.full(point.shape, np.nan, complex)
    tolerance = float(np.finfo(orbit.dtype).eps) ** 0.6 * (box.width * box.cells).max()
    for k in _PERIODS:
        at, back = _returns(box, orbit, k)
        begin = orbit[np.arange(len(orbit)), at]
        new, error, slope = newton(map, box, params, begin, np.full(len(begin), k, np.int32))
        own = np.linalg.eigvals(np.where(np.isfinite(slope), slope, 0)).astype(complex)
        own = np.take_along_axis(own, np.argsort(-np.abs(own), axis=1), axis=1)
        good = (period == 0) & (error < tolerance) & (np.abs(own[:, 0]) > 1)
        good &= (back < _MOVED) & (box.apart((new - begin) / box.width).max(axis=-1) < _MOVED)
        point[good], period[good], multipliers[good] = new[good], k, own[good]
    # Newton's method leaves rounding in place of zeros.
    small = np.finfo(orbit.dtype).eps * (box.width * box.cells)
    point = np.where(np.abs(point) < small, 0.0, box.wrapped(point))
    return point, period, multipliers


def _returns(
    box: Box, orbit: Float[np.ndarray, "states window axes"], period: int
) -> tuple[Int[np.ndarray, "states"], Float[np.ndarray, "states"]]:
    """Find the point of each orbit that moves least in `period` mappings, and how far, in cells."""
    back = box.apart((orbit[:, period:] - orbit[:, :-period]) / box.width).max(axis=-1)
    back = np.where(np.isnan(back), np.inf, back)
    return back.argmin(axis=1), back.min(axis=1)


def _different(
    box: Box, labels: Int[np.ndarray, "states 2"], orbit: Float[np.ndarray, "states window axes"]
) -> list[int]:
    """Return the indices of the edge states whose orbit meets no orbit of an earlier edge state."""
    kept: list[int] = []
    for k in np.flatnonzero((labels >= 0).all(axis=1)):
        others = [other for other in kept if (labels[other] == labels[k]).all()]
        between = orbit[others][:, :, None] - orbit[k]
        if not np.any(box.apart(between / box.width).max(axis=-1) < _SAME):
            kept.append(int(k))
    return kept
