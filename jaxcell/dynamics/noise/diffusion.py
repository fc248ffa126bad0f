import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.precision import require_x64
from ...base.shown import Pictured
from ...base.wide import traced
from ...mapping import Chain
from ...space.box import Box
from ..imaging import check_map, mapped_points
from ..maps import Flow, with_params
from .deviations import deviations_of, is_covariance
from .ends import Ends, Region, within


# The two points of Gauss' rule on a way of length 1.
_NODES = 0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)
# Below this exponent a rate is 0 in 64 bits, and its derivative too.
_NEVER = -700.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Diffusion(Pictured):
    """A stochastic differential equation on the cells of a box. [`diffusion`][] returns it."""

    chain: Chain
    "The chain over the cells of the box, followed by one cell for each of `ends`, where it stays."
    duration: Float[Array | np.ndarray, ""]
    "The mean duration of a step; each step has an exponential duration."
    ends: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    "The names of the regions, and of the sides of the box that are sinks, as `below x0`."


def diffusion(
    field: Flow | Callable[..., Any],
    box: Box,
    params: Any = None,
    *,
    noise: float | Array | tuple[float | Array, ...] | Callable[..., Any],
    into: Mapping[str, Region] | Region | None = None,
) -> Diffusion:
    """Build the Markov chain of a stochastic differential equation `dX = f(X) dt + s(X) dW` (Ito).

    The process moves from a cell to its neighbours in continuous time, so that it is seen wherever
    it crosses a boundary. The rates are those of finite volumes with exponentially fitted fluxes
    (Scharfetter and Gummel 1969): the exponent, the integral of `f / (s^2 / 2)` from a centre to
    the next, is computed from two points. All rates are positive, so that rare events have all
    their digits. The process ends at the sides of the box that are sinks, is reflected at those
    that are clamped, and ends at the boundary of a region, which need not follow the cells.

    The chain is uniformised: in each step it goes to a neighbour or stays. Mean times are its
    numbers of steps times `duration`, with an error that is proportional to the squared width of
    cells. Without noise along an axis, rates are upwind, and the error is proportional to the
    width: there, [`jaxcell.dynamics.chain`][] of a flow is more accurate.

    **Arguments:**

    - `field`: the drift `f`, `field(x, params)`, or a [`jaxcell.dynamics.flow`][] of it.
    - `box`: the cells.
    - `params`: the parameters of the drift and the noise. They and `noise` may be traced by `jit`,
        `vmap` and `grad`.
    - `noise`: the standard deviation `s` per square root of time along each axis: one number, one
        per axis, or a function `noise(x, params)` that returns either.
    - `into`: a region in which the process ends, or several by their names. A region is a function
        of points `[points, axes]` that returns a mask, or cells of the box as a mask or a list. A
        cell in a region leads to the end of the region in one step.

    **Returns:** a [`Diffusion`][].

    Brownian motion from the middle of [-1, 1] leaves it after a mean time of 1:

        >>> from jaxcell import dynamics, markov, space
        >>> box = space.Box([-1], [1], cells=[41])
        >>> walk = dynamics.diffusion(lambda x, p: 0 * x, box, noise=1.0)
        >>> walk.ends
        ('below x0', 'above x0')
        >>> steps = markov.hitting_times(walk.chain, [41, 42]).value
        >>> round(float(walk.duration * steps[20]), 3)
        1.0
    """
    require_x64("a diffusion")
    return diffusion_to(field, Ends.of(box, regions_of(into, box)), params, noise)


def regions_of(into: Any, box: Box) -> dict[str, Any]:
    """Return regions by their names; a single region is named `target`.

    **Raises:** `ValueError` for regions that share centres of cells.
    """
    if not isinstance(into, Mapping):
        return {} if into is None else {"target": into}
    centre = box.centre(np.arange(box.size, dtype=np.int32))
    inside = {name: within(region, box, name)(centre) for name, region in into.items()}
    for one, other in itertools.combinations(inside, 2):
        if (both := inside[one] & inside[other]).any():
            point = ", ".join(f"{x:.4g}" for x in centre[both.argmax()])
            raise ValueError(
                f"into: {one!r} and {other!r} overlap, as at ({point}); expected regions that "
                "have no points in common"
            )
    return dict(into)


def diffusion_to(
    field: Flow | Callable[..., Any], ends: Ends, params: Any, noise: Any
) -> Diffusion:
    """Build a [`diffusion`][] with given ends."""
    box = ends.box
    field = field.field if isinstance(field, Flow) else with_params(field, 2, "field")
    check_map(field, box, params)
    if is_covariance(noise):
        raise ValueError(
            "noise: a flow has independent noise along its axes; with the eigenvalues v and the "
            "eigenvectors U of the covariance matrix (numpy.linalg.eigh), give the field "
            "U.T @ f(U @ y) of y = U.T @ x, regions and a box of y, and sqrt(v) as noise"
        )
    deviation = deviations_of(noise, box)
    cells = np.arange(box.size, dtype=np.int32)
    centre = box.centre(cells)
    moves = [(axis, *pair) for axis in range(box.dimensions) for pair in _ways(ends, axis)]
    volume = {
        axis: sum(length for own, _, _, length in moves if own == axis) / 2
        for axis in range(box.dimensions)
    }
    here = deviation(jnp.asarray(centre), params) ** 2 / 2
    images, rates = [], list[Any]()
    for axis, sign, image, length in moves:
        drift, fit = 0.0, 0.0
        noisy = here[:, axis] > 0
        for node in _NODES:
            point = centre.copy()
            point[:, axis] += sign * node * length
            force = sign * mapped_points(field, params, point[:, None])[:, 0, axis]
            spread = deviation(jnp.asarray(point), params)[:, axis] ** 2 / 2
            noisy &= spread > 0
            drift += force * length / 2
            fit += force * length / 2 / jnp.where(spread > 0, spread, 1.0)
        fitted = here[:, axis] * _bernoulli(jnp.where(noisy, fit, 0.0))
        rate = jnp.where(noisy, fitted, jnp.maximum(drift, 0.0)) / (length * volume[axis])
        images.append(image)
        rates.append(jnp.where(ends.alive & (image != cells), rate, 0.0))
    total = jnp.sum(jnp.stack(rates), axis=0)
    fastest = jax.lax.stop_gradient(jnp.max(total))
    if not traced(fastest) and not 0 < fastest < np.inf:
        if float(fastest) == 0:
            raise ValueError("noise: expected drift or noise in some cell, got 0 in all cells")
        point = ", ".join(f"{x:.4g}" for x in centre[int(jnp.argmin(jnp.isfinite(total)))])
        raise ValueError(f"field: expected finite numbers, got others near ({point})")
    alive = ends.alive.astype(float)
    stays = alive * (1 - total / fastest)
    # A cell in a region leads to its end.
    images = [cells, *images, np.where(ends.alive, cells, box.size + ends.end)]
    chances = [stays, *(rate / fastest for rate in rates), 1 - alive]
    last = np.arange(box.size, ends.cells)
    tail = np.ones((len(images), last.size)) * (np.arange(len(images)) == 0)[:, None]
    image = np.concatenate([np.stack(images), np.tile(last, (len(images), 1))], axis=1)
    chance = jnp.concatenate([jnp.stack(chances), jnp.asarray(tail)], axis=1)
    return Diffusion(Chain(image.astype(np.int32), chance), 1 / fastest, ends.names)


def _ways(ends: Ends, axis: int) -> list[tuple[int, Any, Any]]:
    return [(sign, *ends.step(axis, sign)) for sign in (-1, 1)]


def _bernoulli(fit: Any) -> Any:
    """Compute `w / (1 - exp(-w))`, the factor of the rate along a fitted exponent `w`."""
    small = jnp.abs(fit) < 1e-3
    safe = jnp.clip(jnp.where(small, 1.0, fit), _NEVER, None)
    series = 1 + fit / 2 + fit**2 / 12
    return jnp.where(small, series, safe / -jnp.expm1(-safe))
