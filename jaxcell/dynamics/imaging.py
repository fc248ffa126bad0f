"""Images of all cells of a box, in chunks of bounded memory."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.doubts import warn
from ..base.indices import check_whole
from ..base.quantities import Result
from ..base.wide import OnHostError, traced
from ..space.box import Box
from .batches import CHUNK, in_stages, in_threads, padded, params_of, stacked
from .maps import Flow, Map


# Number of steps between two checks for points that are far enough from their start.
_STAGE = 8

Say = Callable[[str, int, int], None]


def images(
    map: Map, box: Box, params: Any = None, *, follow: int = 0
) -> Int[Array | np.ndarray, "cells"]:
    """Map the centre of every cell, in chunks of 262,144 cells on two threads.

    **Arguments:**

    - `map`: a [`Map`][jaxcell.dynamics.Map].
    - `box`: the cells.
    - `params`: the parameters of the map, its second argument. They may be traced by `jit` and
        `vmap`, with all chunks in one program.
    - `follow`: number of further mappings after which an image outside the box counts as lost.
        Transients and attractors may leave the box and return.

    **Returns:** the image of each cell: a cell, `box.outside` or `box.nowhere`.

    The doubling map on eight cells:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[8], axes="periodic")
        >>> dynamics.images(lambda x, p: 2 * x, box).tolist()
        [1, 3, 5, 7, 1, 3, 5, 7]
    """
    check_map(map, box, params)
    follow = check_whole("follow", follow)
    if traced(params):
        return _traced_images(map, box, params, follow)
    return images_of_each(map, box, [params], follow=follow)[0]


def images_of_each(
    map: Map,
    box: Box,
    members: Sequence[Any],
    *,
    follow: int = 0,
    dtype: Any = None,
    out: Int[np.ndarray, "members cells"] | None = None,
    time: Float[np.ndarray, "members cells"] | None = None,
    within: slice = slice(None),
    say: Say | None = None,
) -> Int[np.ndarray, "members cells"]:
    """Compute [`images`][jaxcell.dynamics.images] for each set of parameters in `members`.

    Only cells in the range `within` are mapped. Images are written into `out`, and the durations of
    the mappings into `time`, if these arrays are given.
    """
    image = np.empty((len(members), box.size), np.int32) if out is None else out
    size = min(max(1, CHUNK // len(members)), box.size)

    def compute(start: int) -> int:
        first = min(start, box.size - size)
        cells = np.arange(first, first + size, dtype=np.int32)
        part = slice(first, first + size)
        image[:, part], taken = _images_of(map, box, members, cells, follow, dtype)
        if start == 0 and (image[:, part] == box.nowhere).all():
            check_begin(map, box, members[0])
        if time is not None:
            time[:, part] = taken
        return first + size

    for done in in_threads(compute, range(*within.indices(box.size)[:2], size)):
        if say is not None:
            say("mapping cells", done, box.size)
    return image


def check_map(map: Map, box: Box, params: Any) -> None:
    """Raise `ValueError` if JAX cannot trace the map, or its result has a wrong shape or type."""
    middle = jax.ShapeDtypeStruct((box.dimensions,), jnp.zeros(()).dtype)
    try:
        image = jax.eval_shape(map, middle, params)
    except KeyError as error:
        raise ValueError(
            f"map: there is no parameter {error}; pass params={{{error}: ...}}"
        ) from error
    except (TypeError, LookupError, AttributeError, NameError, ArithmeticError) as error:
        if params is None and "not subscriptable" in str(error):
            # An error about a missing key names the parameter.
            check_map(map, box, {})
        raise ValueError(f"map: fails at the middle of the box: {_reason(error)}") from error
    if not hasattr(image, "shape"):
        raise ValueError(f"map: expected an array, got a {type(image).__name__}")
    if image.shape != middle.shape:
        raise ValueError(
            f"map: expected an array of shape {list(middle.shape)}, got {list(image.shape)}"
        )
    if image.dtype != middle.dtype:
        raise ValueError(f"map: expected numbers of {middle.dtype}, got {image.dtype}")


def _reason(error: BaseException) -> str:
    """Describe why JAX cannot trace a map, and what to write instead."""
    # A function of the library that calls the map names itself.
    while isinstance(error, OnHostError) and error.__cause__ is not None:
        error = error.__cause__
    if isinstance(error, jax.errors.JAXTypeError):
        return "JAX traces it: write jax.numpy.sin for numpy.sin and math.sin, jnp.where for `if`"
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def check_begin(map: Map, box: Box, params: Any) -> None:
    """Raise `ValueError` if a map, or the field of a flow, has no finite value at 64 points."""
    begin = getattr(map, "velocity", map)
    begun = np.asarray(mapped_points(begin, params, _anywhere(box)[:, None]))
    if not np.isfinite(begun).all(axis=-1).any():
        what = "map" if begin is map else "field"
        raise ValueError(f"{what}: expected finite numbers, got none at {len(begun)} points")


def check_finite(
    image: Float[np.ndarray, "cells points axes"],
    points: Float[np.ndarray, "cells points axes"],
    params: Any,
) -> None:
    """Raise `ValueError` if an image of a point is not finite."""
    lost = ~np.isfinite(image).all(axis=-1)
    if lost.any():
        place, value = points[lost][0].tolist(), image[lost][0].tolist()
        raise ValueError(
            f"map: expected finite numbers in all cells outside of regions, got {value} at {place} "
            f"with {params}"
        )


def _anywhere(box: Box) -> Float[np.ndarray, "points axes"]:
    """Draw 64 random points of a box, the same in every call."""
    return np.random.default_rng(0).uniform(box.lower, box.upper, (64, box.dimensions))


def torn_axes(
    map: Map, box: Box, members: Sequence[Any], labels: tuple[str, ...] = ()
) -> list[tuple[int, ...]]:
    """Warn of periodic axes at whose lower and upper ends a map has different values.

    Returns these axes for each set of parameters in `members`, according to a test at 64 points.
    """
    points, params = _anywhere(box), stacked(members)
    each = [params_of(params, k) for k in range(len(members))]
    torn: list[tuple[int, ...]] = [()] * len(members)
    for axis in (axis for axis, kind in enumerate(box.axes) if kind == "periodic"):
        ends = np.stack([points, points])
        ends[0, :, axis], ends[1, :, axis] = box.lower[axis], box.upper[axis]
        image = np.stack([mapped_points(map, own, ends) for own in each])
        apart = box.apart((image[:, 1] - image[:, 0]) / box.width).max(axis=-1)
        # The median ignores points from which orbits separate by rounding.
        differs = np.median(apart, axis=1) > 1e-3
        torn = [(*axes, axis) if new else axes for axes, new in zip(torn, differs, strict=True)]
        if differs.any():
            warn(remark_of_torn(axis_names(box, labels)[axis]))
    return torn


def remark_of_torn(name: str) -> str:
    """Return the warning that a map differs at the two ends of the periodic axis `name`."""
    return f"The axis {name} is periodic, but the map differs at its two ends."


def axis_names(box: Box, labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the axes of a box, by default `x0`, `x1`, ..."""
    return labels or tuple(f"x{axis}" for axis in range(box.dimensions))


class OnBox(Result):
    """The base class of results that describe the cells of a box, whose axes may have names."""

    box: Box
    labels: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the axes, by default `x0`, `x1`, ..."""
        return axis_names(self.box, self.labels)

    @property
    def attributes(self) -> Mapping[str, Any]:
        return {
            "box_lower": list(self.box.lower),
            "box_upper": list(self.box.upper),
            "box_cells": list(self.box.cells),
            "box_axes": " ".join(self.box.axes),
            "box_labels": ", ".join(self.names),
        }


@functools.partial(jax.jit, static_argnames="map")
def mapped_points(map: Map, params: Any, points: Any) -> Any:
    """Map each point of an array `[cells, points, axes]`; the result has the same shape."""
    return jax.vmap(jax.vmap(lambda x: jnp.asarray(map(x, params))))(points)


def changed_by_half_step(
    map: Any,
    box: Box,
    members: Sequence[Any],
    image: Int[np.ndarray, "members cells"],
    *,
    follow: int = 0,
    dtype: Any = None,
) -> list[float | None]:
    """Estimate, from 1 % of the cells, the share of images that differ with steps half as long.

    Returns a share for each set of parameters in `members`, or `None` for a map without steps.
    """
    if not hasattr(map, "halved"):
        return [None] * len(members)
    count = int(np.clip(box.size // 100, min(box.size, 256), 1 << 16))
    cells = np.random.default_rng(0).integers(0, box.size, count, dtype=np.int32)
    half, _ = _images_of(map.halved(), box, members, cells, follow, dtype)
    return (image[:, cells] != half).mean(axis=1).tolist()


def _images_by_crossing(
    map: Flow, box: Box, params: Any, each: Any, cells: Any, follow: int, dtype: Any
) -> tuple[np.ndarray, np.ndarray]:
    def stage(state: Any, k: int) -> Any:
        members, cells, points, taken = state
        steps = min(_STAGE, map.steps - k * _STAGE)
        points, taken, index, away = _cross(map, box, params, *state, steps)
        ended = away | (k * _STAGE + steps >= map.steps)
        return (members, cells, points, taken), ended, (index, points, taken)

    members, start = np.repeat(each, len(cells)), np.tile(cells, len(each))
    begun = members, start, np.asarray(box.centre(start, dtype)), np.zeros_like(start)
    index, points, taken = in_stages(begun, stage)
    lost = index == box.outside
    if follow and lost.any():
        steps = follow * map.steps
        index[lost] = padded(
            lambda *rows: _followed(map, box, params, *rows, steps), (members[lost], points[lost])
        )
    shape = len(each), len(cells)
    return index.reshape(shape), taken.reshape(shape) * map.dt


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _cross(
    map: Flow, box: Box, params: Any, members: Any, cells: Any, points: Any, taken: Any, steps: Any
) -> Any:
    """Move points up to `steps` steps, until they leave the box or are `map.crossing` cells away.

    The orbits began in `cells`, and `taken` counts the steps of each orbit so far.
    """

    def cross(member, cell, x, taken):  # type: ignore[no-untyped-def]
        return _cross_one(map, box, params_of(params, member), cell, x, taken, steps)

    return jax.vmap(cross)(members, cells, points, taken)


def _cross_one(map: Flow, box: Box, own: Any, cell: Any, x: Any, taken: Any, steps: Any) -> Any:
    here = box.coordinates(cell).astype(x.dtype)

    def step(_, state):  # type: ignore[no-untyped-def]
        y, taken, away = state
        before = jnp.stack(y)
        y = tuple(jnp.where(away, before, map.one(before, own)))
        return y, jnp.where(away, taken, taken + 1), _away(map, box, here, y)

    # Components are separate, as in a step.
    state = tuple(x), taken, _away(map, box, here, x)
    y, taken, away = jax.lax.fori_loop(0, steps, step, state)
    return jnp.stack(y), taken, box.index(jnp.stack(y)), away


def _away(map: Flow, box: Box, here: Any, y: Any) -> Any:
    """Check whether point `y` is outside the box, or at least `map.crossing` cells from `here`."""
    there, inside = box.places(jnp.stack([*y]))
    apart = box.apart(there - here)
    return functools.reduce(jnp.logical_or, apart >= map.crossing, ~inside)


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _followed(map: Flow, box: Box, params: Any, members: Any, points: Any, steps: Any) -> Any:
    def follow(member, x):  # type: ignore[no-untyped-def]
        return _until_inside(map.one, box, x, params_of(params, member), steps)

    return jax.vmap(follow)(members, points)


def _until_inside(map: Map, box: Box, x: Any, params: Any, follow: Any) -> Any:
    def lost(state):  # type: ignore[no-untyped-def]
        y, left = state
        return (box.index(y) == box.outside) & (left > 0)

    y, _ = jax.lax.while_loop(lost, lambda s: (map(s[0], params), s[1] - 1), (x, follow))
    return box.index(y)


@functools.partial(jax.jit, static_argnames=("map", "box", "follow", "dtype"))
def _images(
    map: Map,
    box: Box,
    params: Any,
    members: Int[Array, "members"],
    cells: Int[Array, "size"],
    follow: int,
    dtype: Any,
) -> tuple[Int[Array, "members size"], Float[Array, "members size"] | None]:
    def image(member, cell):  # type: ignore[no-untyped-def]
        return _image(map, box, params_of(params, member), cell, follow, dtype)

    return jax.vmap(lambda member: jax.vmap(lambda cell: image(member, cell))(cells))(members)


def _image(map: Map, box: Box, own: Any, cell: Any, follow: int, dtype: Any) -> tuple[Any, Any]:
    x = box.centre(cell, dtype)
    y, time = map.timed(x, own) if hasattr(map, "timed") else (map(x, own), None)
    return (_until_inside(map, box, y, own, follow) if follow else box.index(y)), time


def _traced_images(map: Map, box: Box, params: Any, follow: int) -> Int[Array, "cells"]:
    """Compute [`images`][jaxcell.dynamics.images] in a program that JAX traces."""
    kind = jnp.zeros(()).dtype
    own = jax.tree.map(lambda leaf: jnp.asarray(leaf, kind), params)

    def image(cell: Any) -> Any:
        if not (isinstance(map, Flow) and map.crossing):
            return _image(map, box, own, cell, follow, kind)[0]

        def stage(state: Any) -> Any:
            k, x, taken, *_ = state
            steps = jnp.minimum(_STAGE, map.steps - k)
            return k + steps, *_cross_one(map, box, own, cell, x, taken, steps)

        state = jnp.zeros_like(cell), box.centre(cell, kind), *[jnp.zeros_like(cell)] * 2, cell < 0
        _, x, _, index, _ = jax.lax.while_loop(
            lambda state: (state[0] < map.steps) & ~state[-1], stage, state
        )
        return _until_inside(map.one, box, x, own, follow * map.steps) if follow else index

    return jax.lax.map(image, jnp.arange(box.size, dtype=jnp.int32), batch_size=CHUNK)


def _images_of(
    map: Map,
    box: Box,
    members: Sequence[Any],
    cells: Int[np.ndarray, "size"],
    follow: int,
    dtype: Any,
) -> tuple[Int[np.ndarray, "members size"], Float[np.ndarray, "members size"] | None]:
    """Compute the images of cells, and the durations of their mappings if these differ."""
    kind = jnp.zeros(()).dtype if dtype is None else jnp.dtype(dtype)
    params, each = stacked(members, kind), np.arange(len(members))
    if isinstance(map, Flow) and map.crossing:
        return _images_by_crossing(map, box, params, each, cells, follow, kind)
    image, time = _images(map, box, params, each, cells, follow, kind)
    return np.asarray(image), None if time is None else np.asarray(time)
