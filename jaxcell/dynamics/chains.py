import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.precision import require_x64
from ..mapping import Chain
from ..space.box import Box
from .imaging import check_map
from .maps import Flow, Map


def chain(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    samples: int = 16,
    noise: float | tuple[float, ...] = 0.0,
    key: Any = None,
) -> Chain:
    """The generalized map of a box: images of points inside each cell, with additive noise.

    A cell is mapped from `samples` random points of it (Hsu 1981, Ulam's method), and to each image
    normal noise is added. Images outside the box go to the sink of the chain.

    **Arguments:**

    - `map`, `box`, `params`: as for [`jaxcell.dynamics.images`][].
    - `samples`: points of each cell, all of one weight.
    - `noise`: standard deviation of what is added to an image, along all axes or along each.
    - `key`: of JAX's random numbers, by default `jax.random.key(0)`.

    **Returns:** [`jaxcell.mapping.Chain`][], for all of [`jaxcell.markov`][].

    **Raises:** `ValueError` for no samples, noise that is negative, or a map as
    [`jaxcell.dynamics.images`][] says. `RuntimeError` where JAX is set to 32 bits.

    A walk on a ring:

        >>> import jax
        >>> jax.config.update("jax_enable_x64", True)
        >>> from jaxcell import dynamics, mapping, space
        >>> ring = space.Box([0], [1], cells=[10], axes="periodic")
        >>> walk = dynamics.chain(lambda x, p: x, ring, samples=64, noise=0.2)
        >>> int(mapping.persistent_groups(walk).count)
        1
    """
    require_x64("a chain of a map")
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    deviation = np.broadcast_to(np.asarray(noise, float), (box.dimensions,))
    if not (np.isfinite(deviation).all() and (deviation >= 0).all()):
        raise ValueError(f"noise: expected numbers from 0, got {noise}")
    if isinstance(map, Flow) and map.crossing:
        raise ValueError("map: noise needs the same time everywhere; give flow a number of steps")
    check_map(map, box, params)
    key = jax.random.key(0) if key is None else key
    image = _sampled(map, box, params, jnp.asarray(deviation), key, samples)
    inside = image < box.size
    # What left the box is missing from the probabilities of its cell.
    cells = np.arange(box.size, dtype=np.int32)
    return Chain(jnp.where(inside, image, cells), jnp.where(inside, 1 / samples, 0.0))


@functools.partial(jax.jit, static_argnames=("map", "box", "samples"))
def _sampled(
    map: Map, box: Box, params: Any, deviation: Float[Array, "axes"], key: Any, samples: int
) -> Int[Array, "samples cells"]:
    centre = box.centre(jnp.arange(box.size, dtype=jnp.int32))
    width = jnp.asarray(box.width)[None]

    def sample(key):  # type: ignore[no-untyped-def]
        within, added = jax.random.split(key)
        start = centre + jax.random.uniform(within, centre.shape, minval=-0.5, maxval=0.5) * width
        end = jax.vmap(lambda x: map(x, params))(start)
        return box.index(end + deviation[None] * jax.random.normal(added, end.shape))

    return jax.lax.map(sample, jax.random.split(key, samples))
