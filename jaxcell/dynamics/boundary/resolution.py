import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...space.box import Box
from ..maps import Flow, Map
from ..orbits import attractor_owners, orbit_ends


AGREE = 0.02
"""A remedy for coarse cells succeeds if at most this share of points has a wrong attractor."""
DOUBTFUL = 0.05
"""Remedies for coarse cells are tested if `Basins.disagreement` is larger than this share."""
# Number of points whose cells are compared with their orbits, and of halvings that are tried.
_POINTS = 1 << 10
_HALVINGS = 2
# Largest number of mappings of finer cells.
_MAX_MAPPINGS = 1 << 12
# Numbers of mappings outside the box that are tried.
_FOLLOWED = 0, 1, 4, 16, 64
# The least exponent with which cells of half the width help.
_LEAST = 0.15


@dataclasses.dataclass(frozen=True)
class Trial:
    """A test at random points of two remedies for coarse cells: finer cells, and `by="orbits"`."""

    follow: int | None
    "The least `follow` with which orbits reach the right attractors; `None` if it was not found."
    points: int = 0
    "Number of random points at which cells and orbits were compared."
    wrong: tuple[float, ...] = ()
    "Shares of points with a wrong attractor, for these cells and cells of 1/2 and 1/4 the width."
    cells: tuple[int, ...] | None = None
    """Number of cells along each axis that should reduce `wrong` to 2 %; `None` if finer cells do
    not help, or if 32 bits cannot number them."""


def tried(map: Map, basins: Any) -> Trial:
    """Test whether orbits or finer cells would correct [`Basins`][jaxcell.dynamics.Basins]."""
    box, owner = basins.box, attractor_owners(basins.box, basins.attractor_cells)
    params = jax.tree.map(jnp.asarray, basins.params)

    def reached(points: Float[np.ndarray, "points axes"], follow: int) -> np.ndarray:
        return np.maximum(orbit_ends(map, box, params, owner, points, follow=follow)[0], -1)

    needed = None
    for follow in _FOLLOWED:
        if (
            follow >= basins.follow
            and np.mean(reached(basins.starts, follow) != basins.ends) <= AGREE
        ):
            needed = follow
            break
    if needed is None or (isinstance(map, Flow) and map.crossing):
        return Trial(needed)
    points = np.random.default_rng(1).uniform(box.lower, box.upper, (_POINTS, box.dimensions))
    truth = reached(points, needed)
    wrong = [float(np.mean(basins.basin[box.index(points)] != truth))]
    for level in range(1, _HALVINGS + 1):
        mappings = min(_MAX_MAPPINGS, 2 * basins.longest_step << level)
        finer = Box(box.lower, box.upper, [1] * box.dimensions, box.axes)
        last, left = _snapped(
            map, finer, params, points, box.width / 2**level, mappings, basins.follow
        )
        label = np.where(np.asarray(left), -1, reached(np.asarray(last), needed))
        wrong.append(float(np.mean(label != truth)))
    return Trial(needed, _POINTS, tuple(wrong), _cells(box, wrong))


def _cells(box: Box, wrong: list[float]) -> tuple[int, ...] | None:
    """Extrapolate the number of cells along each axis for which the share `wrong` is `AGREE`."""
    for level, share in enumerate(wrong):
        if share <= AGREE:
            return tuple(n << level for n in box.cells)
    exponent = math.log2(wrong[0] / wrong[-1]) / (len(wrong) - 1)
    if exponent < _LEAST:
        return None
    finer = 2 ** (len(wrong) - 1 + math.log2(wrong[-1] / AGREE) / exponent)
    cells = tuple(math.ceil(n * finer) for n in box.cells)
    return cells if math.prod(cells) < np.iinfo(np.int32).max else None


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _snapped(
    map: Map, box: Box, params: Any, points: Any, width: Any, mappings: Any, follow: Any
) -> Any:
    """Map points repeatedly, each time from the centre of the cell that contains the point."""
    lower = jnp.asarray(np.array(box.lower), points.dtype)

    def centred(x):  # type: ignore[no-untyped-def]
        return lower + (jnp.floor((x - lower) / width) + 0.5) * width

    def orbit(x):  # type: ignore[no-untyped-def]
        def step(_, state):  # type: ignore[no-untyped-def]
            x, away = state
            x = box.wrapped(map(centred(x), params))
            outside = box.index(x) >= box.size
            return x, jnp.where(away > follow, away, jnp.where(outside, away + 1, 0))

        x, away = jax.lax.fori_loop(0, mappings, step, (x, 0))
        return centred(x), away > follow

    return jax.vmap(orbit)(points)
