import functools
import inspect
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import csr_array, vstack
from scipy.special import ndtr

from ...base import memory
from ...base.doubts import warn
from ...base.indices import check_whole
from ...base.precision import require_x64
from ...base.wide import traced
from ...mapping import Chain, persistent_groups
from ...space.box import Box
from ..batches import padded
from ..imaging import check_begin, check_finite, check_map, mapped_points, torn_axes
from ..maps import Flow, Map
from .deviations import deviations_of, listed, with_correlation
from .normal import all_probabilities, distributed_rows, nodes, transition_rows


# Largest number of probabilities that are computed at once, and the bytes for each one of a chain.
_PART = 1 << 22
_BYTES = 60
# Number of cells among which the tail of the noise is divided in the second chain.
_LINKS = 32


def chain(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    samples: int = 16,
    noise: float | Array | np.ndarray | tuple[float | Array, ...] | Callable[..., Any] = 0.0,
    deviations: float = 8.0,
    key: Any = None,
) -> Chain:
    """Build the generalized map of a box: images of points inside each cell, with normal noise.

    Each cell is mapped from `samples` of its points (Hsu 1981, Ulam's method). The points of a cell
    are an additive recurrence from a random start, which spreads them evenly. Normal noise is
    added to each image: the probability of a cell is the difference between the values of the
    distribution function at its faces, or a product of such differences in several dimensions.
    It has all its digits far out in the tails, too. Images outside the box go to the sink of the
    chain, whose probability is 1 minus that of all cells, and 0 below 1e-12. If the box is left
    more rarely, extend it with `axes="clamp"`, and use the cells beyond its ends as a target.

    A chain forgets the place of a point in its cell. So `chain.half` is a second chain from cells
    of three times the width around the same centres, with half as many samples. In it, the noise
    beyond `deviations` leads to cells anywhere along the axes with noise.
    [`jaxcell.dynamics.moved`][] computes the differences between the results of both chains, which
    [`jaxcell.markov.hitting_times`][] and [`jaxcell.markov.arrival_probabilities`][] have in the
    field `moved`. Take their maximum over starts: at a start where they cross zero, the error can
    be many times as large. On 37 random systems with known results, the maximum was 0.7 to 116
    times the largest error, and above it on 35. If it is too large, take more cells; cells should
    be smaller than the noise. The chain has no state between the ends of two mappings, so it does
    not see that a process in continuous time is in a target there:
    [`jaxcell.dynamics.diffusion`][] does.

    **Arguments:**

    - `map`, `box`, `params`: as in [`jaxcell.dynamics.images`][]. Parameters and `noise` may be
        traced by `jit`, `vmap` and `grad`. Then every cell has every cell as an image, nothing is
        cut off, and there is no second chain. Noise along a periodic axis cannot be traced.
    - `samples`: number of points of each cell, with equal weights.
    - `noise`: standard deviation of the noise, one number for all axes or one per axis; or a
        function `noise(x, params)` of the state before the mapping that returns either. A function
        `noise(z, y, params)` is a distribution function instead: the probability, along each axis,
        that the next point is at most `z` if the image is `y`; see the example of births. In a box
        with two axes, a matrix is the covariance of the noise.
    - `deviations`: number of standard deviations at which the noise is cut along each axis. The
        mass beyond it, 1.2e-15 by default, is added to the last cell within.
    - `key`: random key of JAX, by default `jax.random.key(0)`.

    **Returns:** a chain over the cells of the box.

    A walk on a ring:

        >>> from jaxcell import dynamics, mapping, space
        >>> ring = space.Box([0], [1], cells=[10], axes="periodic")
        >>> walk = dynamics.chain(lambda x, p: x, ring, samples=64, noise=0.2)
        >>> int(mapping.persistent_groups(walk).count)
        1

    A population that has one child per head on average, by the law of Poisson:

        >>> import jax.numpy as jnp
        >>> from jax.scipy.stats import poisson
        >>> heads = space.Box([-0.5], [9.5], cells=[10], axes="clamp")
        >>> births = dynamics.chain(
        ...     lambda x, p: jnp.round(x), heads, noise=lambda z, y, p: poisson.cdf(jnp.floor(z), y)
        ... )
        >>> births.to_scipy()[[1]].toarray()[0, :4].round(3).tolist()
        [0.368, 0.368, 0.184, 0.061]
    """
    require_x64("a chain of a map")
    about: dict[str, Any] = {"samples": samples, "noise": noise, "deviations": deviations}
    if traced(params, noise):
        _check(map, box, params, **about)
        rows = traced_rows(map, box, params, samples=samples, noise=noise, key=key)
        cells = jnp.arange(box.size, dtype=jnp.int32)
        return Chain(jnp.broadcast_to(cells[:, None], rows.shape), rows.T)
    torn_axes(map, box, [params])
    half, whole = (
        Chain.from_scipy(matrix(map, box, params, **about, key=key, second=second))
        for second in (True, False)
    )
    ends = np.array(box.axes) == "sink"
    spread = _spread(noise, box, params)[1]
    if (ends & (spread > 0)).any() and persistent_groups(whole).count:
        warn(
            "noise: leads out of the box with less than 1e-12 per mapping from some groups, which "
            'therefore never leave it; extend the box with axes="clamp", and take the cells beyond '
            "its old ends as a target",
        )
    return Chain(whole.image, whole.probability, half)


def is_law(noise: Any) -> bool:
    """Check whether noise is a distribution function `noise(z, y, params)`."""
    return callable(noise) and len(inspect.signature(noise).parameters) == 3


def _check(map: Map, box: Box, params: Any, samples: int, noise: Any, deviations: float) -> None:
    check_whole("samples", samples, 1)
    if not 1 <= deviations < np.inf:
        raise ValueError(f"deviations: expected a finite number from 1, got {deviations}")
    check_map(map, box, params)
    if isinstance(map, Flow) and map.crossing:
        raise ValueError("map: noise needs equal durations of cells; give flow a number of steps")
    if is_law(noise) and (traced(params) or "periodic" in box.axes):
        raise ValueError(
            "noise: a distribution function needs known parameters and no periodic axis"
        )


def _spread(noise: Any, box: Box, params: Any) -> tuple[Callable[..., Any], Any]:
    """Return the function of standard deviations, and their values at the centres of cells."""
    spread = deviations_of(0.0 if is_law(noise) else with_correlation(noise, box)[0], box)
    each = np.asarray(spread(box.centre(np.arange(box.size, dtype=np.int32)), params))
    if not (np.isfinite(each).all() and (each >= 0).all()):
        raise ValueError(f"noise: expected finite numbers from 0, got {each.min()} to {each.max()}")
    return spread, each


def matrix(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    onto: Box | None = None,
    second: bool = False,
    samples: int = 16,
    noise: Any = 0.0,
    deviations: float = 8.0,
    key: Any = None,
    finite: Bool[np.ndarray, "cells"] | None = None,
) -> csr_array:
    """Compute the transition matrix of a [`chain`][], or of its second chain.

    The rows are the cells of the box, and the columns those of the box `onto`, by default the same.
    Raise `ValueError` if an image of a cell of the mask `finite` is not finite.
    """
    _check(map, box, params, samples, noise, deviations)
    law = noise if is_law(noise) else None
    spread, each = _spread(noise, box, params)
    correlation = with_correlation(noise, box)[1]
    onto = box if onto is None else onto
    deviation = each.max(axis=0)
    window = np.minimum(2 * np.ceil(deviations * deviation / box.width) + 2, onto.cells)
    window = np.array(onto.cells, float) if law else window
    entries = 2 * box.size * window.prod()
    advice = "use fewer cells or fewer deviations"
    memory.check(_BYTES * entries, f"a chain of {box.size} cells", advice)
    wide, samples = (3.0, max(1, samples // 2)) if second else (1.0, samples)
    inner = nodes(correlation, float(deviation[0] / box.width[0]))
    part = int(np.clip(_PART // (samples * inner * window.prod()), 1, box.size))
    shift = _shift(box, key)
    rng = np.random.default_rng(0)
    cut = (deviation > 0) & (deviations * deviation < box.width * box.cells)
    # In the second chain, the tail of each axis leads anywhere.
    tail = 2 * float(ndtr(-deviations)) * np.count_nonzero(cut) if second else 0.0
    rows = []
    for first in range(0, box.size, part):
        cells = np.arange(first, min(first + part, box.size), dtype=np.int32)
        points = _points(box, cells, shift[cells], samples, wide)
        image = padded(lambda points: mapped_points(map, params, points), [points], part)
        if first == 0 and not np.isfinite(image).any():
            check_begin(map, box, params)
        if finite is not None:
            check_finite(image[finite[cells]], points[finite[cells]], params)
        if law is not None:
            rows.append(distributed_rows(onto, image, lambda z, y: _each(law, z, y, params)))
            continue
        own = np.asarray(spread(points.reshape(-1, box.dimensions), params))
        near = transition_rows(onto, image, own.reshape(image.shape), deviations, correlation)
        if tail:
            anywhere = rng.uniform(box.lower, box.upper, (cells.size, _LINKS, box.dimensions))
            ends = np.where(deviation > 0, anywhere, image[:, :1])
            near = (1 - tail) * near + tail * transition_rows(onto, ends, 0 * deviation, 0.0)
        rows.append(near)
    return vstack(rows, format="csr")


@functools.partial(jax.jit, static_argnames="law")
def _each(law: Callable[..., Any], faces: Any, images: Any, params: Any) -> Any:
    """Evaluate a distribution function at arrays of points `[..., axes]`."""
    return jnp.vectorize(lambda z, y: law(z, y, params), signature="(n),(n)->(n)")(faces, images)


def moved(quantity: Callable[[Chain], Any], chain: Chain) -> Any:
    """Estimate the error of a quantity of a chain, from cells of three times the width.

    **Arguments:** a function of a chain, and a chain of [`jaxcell.dynamics.chain`][]. **Returns:**
    the absolute difference between the quantities of `chain` and of `chain.half`, an array or a
    tree of arrays. It is `inf` if only one of two numbers is infinite, or if they have different
    shapes, because the two chains have different numbers of groups.

    The long-run distribution of a noisy map:

        >>> from jaxcell import dynamics, mapping, markov, space
        >>> def distribution(chain):
        ...     return markov.limiting_distribution(chain, mapping.persistent_groups(chain)).value
        >>> box = space.Box([-2], [2], cells=[100], axes="clamp")
        >>> chain = dynamics.chain(lambda x, p: x / 2, box, noise=0.25)
        >>> float(distribution(chain).max().round(3))
        0.055
        >>> float(dynamics.moved(distribution, chain).max().round(4))
        0.0001
    """
    if chain.half is None:
        raise ValueError("chain: expected a chain of dynamics.chain, whose field half is a chain")

    def apart(value: Any, other: Any) -> Float[np.ndarray, "*shape"]:
        value, other = np.asarray(value, float), np.asarray(other, float)
        if value.shape != other.shape:
            return np.full(value.shape, np.inf)
        with np.errstate(invalid="ignore"):
            return np.where(value == other, 0.0, np.abs(value - other))

    return jax.tree.map(apart, quantity(chain), quantity(chain.half))


def traced_rows(
    map: Map,
    box: Box,
    params: Any,
    *,
    noise: Any,
    onto: Box | None = None,
    samples: int = 16,
    key: Any = None,
) -> Float[Array, "cells images"]:
    """Compute the matrix of [`matrix`][], without zeros, in a program that JAX traces."""
    onto = box if onto is None else onto
    spread = deviations_of(noise, box)
    fixed = () if callable(noise) else listed(noise, box.dimensions)
    memory.check(
        24 * box.size * onto.size, f"a traced chain of {box.size} cells", "use fewer cells"
    )
    with jax.ensure_compile_time_eval():
        shift = _shift(box, key)
    points = _points(box, np.arange(box.size, dtype=np.int32), shift, samples, 1.0)

    def row(points: Any) -> Any:
        noises = fixed or tuple(spread(points, params).T)
        return all_probabilities(onto, mapped_points(map, params, points[None])[0], noises)

    part = int(np.clip(_PART // (samples * sum(box.cells)), 1, box.size))
    return jax.lax.map(row, jnp.asarray(points), batch_size=part)


def _shift(box: Box, key: Any) -> Float[np.ndarray, "cells axes"]:
    key = jax.random.key(0) if key is None else key
    return np.asarray(jax.random.uniform(key, (box.size, box.dimensions)))


def _points(
    box: Box,
    cells: Int[np.ndarray, "cells"],
    shift: Float[np.ndarray, "cells axes"],
    samples: int,
    wide: float,
) -> Float[np.ndarray, "cells samples axes"]:
    """Choose points of cells, or of wider cells around the same centres, folded into the box.

    Pairs of points are on opposite sides of the centre, so that linear functions have exact means.
    """
    number = np.arange(samples)[:, None]
    place = (shift[:, None] + number // 2 * _turns(box.dimensions)) % 1.0 - 0.5
    place = wide * np.where(number % 2, -place, place)
    points = box.centre(cells)[:, None] + place * box.width
    lower, length = np.array(box.lower), box.width * box.cells
    folded = lower + length - np.abs(length - np.abs(points - lower))
    return np.where(np.array(box.axes) == "periodic", points, folded)


def sampled(
    box: Box, cells: Int[np.ndarray, "cells"], samples: int = 16
) -> Float[np.ndarray, "cells samples axes"]:
    """Choose the points from which a [`chain`][] maps its cells by default."""
    return _points(box, cells, _shift(box, None)[cells], samples, 1.0)


def _turns(dimensions: int) -> Float[np.ndarray, "dimensions"]:
    """Return the increments of an additive recurrence that fills a cube evenly."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    return ratio ** -np.arange(1.0, dimensions + 1)
