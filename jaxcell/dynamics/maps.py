import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..base.arguments import CONVERTERS
from ..base.indices import check_whole
from ..base.shown import Shown
from .sines import with_sines


# Number of steps of a flow with `crossing` that is applied to a point without a cell.
_LONG = 32

Point: TypeAlias = Float[Array, "axes"]
Field: TypeAlias = Callable[..., Any]
"""The velocity at a point, `field(x, params)` or `field(x)`."""


@runtime_checkable
class Map(Protocol):
    """A map from a space to itself: `map(x, params)` is the point that follows `x`.

    Any hashable function that JAX can trace is a map, for example a function at the top level of a
    module. For stiff fields, use a solver of diffrax with adaptive steps:

        def stiff(x, params):
            term = diffrax.ODETerm(lambda t, y, p: field(y, p))
            control = diffrax.PIDController(rtol=1e-6, atol=1e-9)
            solver, times = diffrax.Kvaerno5(), (0.0, 1.0, 0.01)
            solution = diffrax.diffeqsolve(
                term, solver, *times, x, params, stepsize_controller=control
            )
            return solution.ys[-1]
    """

    # For a type checker this is any function, because one without parameters is a map, too.
    def __call__(self, *args: Any, **options: Any) -> Any: ...


@dataclasses.dataclass(frozen=True)
class _WithoutParams:
    function: Callable[..., Any]

    def __call__(self, *args: Any) -> Any:
        return self.function(*args[:-1])


def with_params(function: Any, count: int, name: str) -> Any:
    """Return a function of `count` arguments, the last of which may be missing in `function`."""
    if not callable(function):
        raise ValueError(f"{name}: expected a function, got {function!r}")
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:
        return function
    places = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    names = [parameter.name for parameter in parameters if parameter.kind in places]
    several = any(one.kind is inspect.Parameter.VAR_POSITIONAL for one in parameters)
    if name == "field" and count == 2 and names[:1] in (["t"], ["time"]):
        raise ValueError(
            "field: it depends on time; strobe(field, period, steps) makes a map of it"
        )
    return _WithoutParams(function) if len(names) == count - 1 and not several else function


CONVERTERS[Map] = lambda function: with_params(function, 2, "map")


@dataclasses.dataclass(frozen=True)
class Flow(Shown):
    """The map that follows an autonomous vector field for some time. [`flow`][] returns it."""

    field: Field
    dt: float
    steps: int
    "Number of Runge-Kutta steps per mapping; the largest number if `crossing` is not 0."
    crossing: int = 0
    "Distance from a cell to its image, in cells; 0 if each mapping takes exactly `steps` steps."

    def __call__(self, x: Any, params: Any) -> Any:
        return self.ahead(x, params, self.usual)

    @property
    def usual(self) -> int:
        """Number of steps used to map a single point: `steps`, or 32 with `crossing`."""
        return _LONG if self.crossing else self.steps

    def velocity(self, x: Any, params: Any) -> Any:
        """Evaluate the field at a point."""
        return self.field(x, params)

    @property
    def duration(self) -> float | None:
        """The duration of a mapping; `None` if it differs between cells."""
        return None if self.crossing else self.dt * self.steps

    def ahead(self, x: Any, params: Any, steps: Any, part: Any = 1.0) -> Any:
        """Return the point after `steps` steps from `x`, each of duration `part * dt`."""
        return _advance(lambda _, y: self.field(y, params), x, self.dt * part, steps)

    def one(self, x: Any, params: Any) -> Any:
        """Return the point after one step of duration `dt` from `x`."""
        return _rk4(lambda _, y: self.field(y, params), x, 0.0, self.dt)

    def halved(self) -> "Flow":
        """Return the same map with steps of half the length."""
        return dataclasses.replace(self, dt=self.dt / 2, steps=2 * self.steps)


@dataclasses.dataclass(frozen=True)
class Strobe:
    """The map that follows a forced vector field for one period. [`strobe`][] returns it."""

    field: Callable[[Any, Any, Any], Any]
    period: float
    steps: int

    def __call__(self, x: Any, params: Any) -> Any:
        def field(t, y):  # type: ignore[no-untyped-def]
            return self.field(t, y, params)

        return _advance(field, x, self.period / self.steps, self.steps)

    def velocity(self, x: Any, params: Any) -> Any:
        """Evaluate the field at a point, at phase 0."""
        return self.field(jnp.zeros(()), x, params)

    @property
    def duration(self) -> float:
        """The duration of a mapping."""
        return self.period

    def halved(self) -> "Strobe":
        """Return the same map with steps of half the length."""
        return dataclasses.replace(self, steps=2 * self.steps)


@dataclasses.dataclass(frozen=True)
class Section:
    """The return map (Poincare map) of a surface under a flow. [`section`][] returns it."""

    flow: Flow
    surface: Callable[[Any, Any], Any]
    lift: Callable[[Any, Any], Any]
    project: Callable[[Any, Any], Any]
    max_steps: int

    def __call__(self, x: Any, params: Any) -> Any:
        return self.timed(x, params)[0]

    def timed(self, x: Any, params: Any) -> tuple[Any, Any]:
        """Follow a point until it returns to the surface, and return the new point and the time."""
        start = jnp.asarray(self.lift(x, params))
        # The arrays are parameters, and others that the functions of the section contain.
        search, arrays = jax.closure_convert(lambda start: self._search(start, params), start)
        return _by_jacobian(search, start, *arrays)

    def _search(self, start: Any, params: Any) -> tuple[Any, Any]:
        def before(state):  # type: ignore[no-untyped-def]
            last, y, steps = state
            crossed = (self.surface(last, params) < 0) & (self.surface(y, params) >= 0)
            # The first step leaves the surface, where the height is 0 and its sign is arbitrary.
            return (~crossed | (steps < 2)) & (steps < self.max_steps + 2)

        def step(state):  # type: ignore[no-untyped-def]
            _, y, steps = state
            return y, self.flow.one(y, params), steps + 1

        last, y, steps = jax.lax.while_loop(before, step, (start, start, 0))

        def after(dt):  # type: ignore[no-untyped-def]
            return _rk4(lambda _, y: self.flow.field(y, params), last, 0.0, dt)

        ends = self.surface(last, params), self.surface(y, params)
        time = _crossing_time(lambda dt: self.surface(after(dt), params), *ends, self.flow.dt)
        back = jnp.where(steps < self.max_steps + 2, self.project(after(time), params), jnp.nan)
        return back, (steps - 1) * self.flow.dt + time

    def velocity(self, x: Any, params: Any) -> Any:
        """Evaluate the field at a point of the surface."""
        return self.flow.field(jnp.asarray(self.lift(x, params)), params)

    def halved(self) -> "Section":
        """Return the same map with steps of half the length."""
        half = dataclasses.replace(self.flow, dt=self.flow.dt / 2)
        return dataclasses.replace(self, flow=half, max_steps=2 * self.max_steps)


def flow(
    field: Field,
    dt: float,
    steps: int | Literal["crossing"] = "crossing",
    *,
    crossed: int = 16,
    max_steps: int = 1000,
) -> Flow:
    """Build the map of an autonomous field `x' = field(x, params)` with Runge-Kutta steps.

    A field without parameters may be `field(x)`.

    **Arguments:**

    - `field`: the velocity at a point, an array `[axes]`.
    - `dt`: duration of a Runge-Kutta step of order 4.
    - `steps`: number of steps per mapping. With `"crossing"` the number differs between cells: the
        orbit of a cell is followed until it is `crossed` cells away (according to Hsu's criterion).
    - `crossed`: with `"crossing"`, the distance from a cell to its image, in cells. So a cell with
        a slow flow is not mapped to itself, and rounding the image to a cell is a small error.
    - `max_steps`: with `"crossing"`, the largest number of steps. A cell whose orbit is still less
        than `crossed` cells away after these steps most likely contains an equilibrium.

    **Returns:** a map for all functions of this package.

    Half a turn of a harmonic oscillator:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> turn = dynamics.flow(lambda x, p: jnp.array([x[1], -x[0]]), dt=jnp.pi / 100, steps=100)
        >>> np.allclose(jax.jit(turn)(np.array([1.0, 0.0]), {}), [-1, 0], atol=1e-5)
        True
    """
    dt, field = _positive("dt", dt), with_params(field, 2, "field")
    crossed, max_steps = check_whole("crossed", crossed, 1), check_whole("max_steps", max_steps, 1)
    if isinstance(steps, str) and steps == "crossing":
        return Flow(field, dt, max_steps, crossing=crossed)
    return Flow(field, dt, check_whole("steps", steps, 1))


def strobe(field: Field, period: float, steps: int) -> Strobe:
    """Build the map of a periodically forced field over one period of the forcing, from phase 0.

    **Arguments:** the velocity, `field(t, x, params)`, the period, and the number of Runge-Kutta
    steps in a period. **Returns:** a map for all functions of this package.

    A force whose effects cancel over a period:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> pushed = dynamics.strobe(lambda t, x, p: jnp.cos(t)[None], 2 * jnp.pi, steps=20)
        >>> np.allclose(jax.jit(pushed)(np.array([0.5]), {}), 0.5, atol=1e-6)
        True
    """
    field = with_params(field, 3, "field")
    return Strobe(field, _positive("period", period), check_whole("steps", steps, 1))


def section(
    field: Field,
    surface: Callable[..., Any],
    *,
    lift: Callable[..., Any],
    project: Callable[..., Any],
    dt: float,
    max_steps: int = 10_000,
) -> Section:
    """Build the return map (Poincare map) of a surface that the orbits of a flow cross.

    Steps continue until `surface` changes its sign from negative to positive. The Illinois method
    then finds the crossing within the last step. A point that does not return in `max_steps` steps
    is mapped to NaN, which a box counts as `nowhere`. Under `grad` a point is followed once for
    each number of the point and the parameters.

    **Arguments:**

    - `field`: the velocity, `field(x, params)`.
    - `surface`: a function `surface(x, params)` that is zero on the surface.
    - `lift`: a function `lift(u, params)` from coordinates on the surface to a point of the space.
    - `project`: a function `project(x, params)` from a point of the surface to its coordinates.
    - `dt`: duration of a step.
    - `max_steps`: largest number of steps until the return.

    **Returns:** a map of coordinates on the surface.

    A spiral on which each turn multiplies the distance from the centre by `exp(-pi / 5)`:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> returns = dynamics.section(
        ...     lambda x, p: jnp.array([-0.1 * x[0] - x[1], x[0] - 0.1 * x[1]]),
        ...     lambda x, p: x[1],
        ...     lift=lambda u, p: jnp.array([u[0], 0.0]),
        ...     project=lambda x, p: x[:1],
        ...     dt=0.05,
        ... )
        >>> np.allclose(jax.jit(returns)(np.array([1.0]), {}), np.exp(-np.pi / 5), atol=1e-5)
        True
    """
    one = Flow(with_params(field, 2, "field"), _positive("dt", dt), 1)
    given = {"surface": surface, "lift": lift, "project": project}
    functions = {name: with_params(function, 2, name) for name, function in given.items()}
    return Section(one, **functions, max_steps=check_whole("max_steps", max_steps, 1))


def _positive(name: str, value: Any) -> float:
    if not hasattr(value, "__float__") or np.ndim(value) or not 0 < value < np.inf:
        raise ValueError(f"{name}: expected a finite number above 0, got {value!r}")
    return float(value)


def _rk4(field: Callable[[Any, Any], Any], x: Any, t: Any, dt: Any) -> Any:
    # Components are separate: a batch is then one array per component, as vector units read it.
    start = tuple(x)

    # JAX traces the field once for all four slopes.
    @jax.jit
    def slope(t: Any, at: tuple[Any, ...]) -> tuple[Any, ...]:
        velocity = jnp.asarray(with_sines(field)(t, jnp.stack(at)))
        if velocity.shape != (len(at),):
            raise ValueError(
                f"field: expected an array of shape {[len(at)]}, got {list(velocity.shape)}"
            )
        return tuple(velocity)

    def ahead(slopes: Sequence[Any], dt: Any) -> tuple[Any, ...]:
        return tuple(y + dt * s for y, s in zip(start, slopes, strict=True))

    # Numbers of Python do not widen points of 32 bits.
    first = slope(t, start)
    second = slope(t + dt / 2, ahead(first, dt / 2))
    third = slope(t + dt / 2, ahead(second, dt / 2))
    fourth = slope(t + dt, ahead(third, dt))
    slopes = zip(first, second, third, fourth, strict=True)
    return jnp.stack(ahead([a + 2 * b + 2 * c + d for a, b, c, d in slopes], dt / 6))


def _advance(field: Callable[[Any, Any], Any], x: Any, dt: Any, steps: Any) -> Any:
    def step(k, components):  # type: ignore[no-untyped-def]
        y = jnp.stack(components)
        return tuple(_rk4(field, y, dt * jnp.asarray(k, y.dtype), dt))

    start = tuple(jnp.asarray(x))
    return jnp.stack(jax.lax.fori_loop(0, steps, step, start))


def _crossing_time(height: Callable[[Any], Any], below: Any, above: Any, dt: float) -> Any:
    """Find a zero of `height`, whose values at 0 and at `dt` are `below` and `above`."""

    def narrow(_, state):  # type: ignore[no-untyped-def]
        low, high, below, above, was_up = state
        # Heights are equal only without a crossing, when the time does not matter.
        gap = jnp.where(above == below, 1.0, above - below)
        time = jnp.clip(high - above * (high - low) / gap, low, high)
        value = height(time)
        up = value >= 0
        # An end that stays for a second time counts half, so that the next time lies beyond zero.
        half = jnp.where(up == was_up, 0.5, 1.0).astype(value.dtype)
        low, high = jnp.where(up, low, time), jnp.where(up, time, high)
        below, above = jnp.where(up, below * half, value), jnp.where(up, value, above * half)
        return low, high, below, above, up

    def search(*_):  # type: ignore[no-untyped-def]
        ends = jnp.zeros_like(below), jnp.full_like(below, dt)
        state = jax.lax.fori_loop(0, 12, narrow, (*ends, below, above, above >= 0))
        return state[1]

    # The derivative of the zero is implicit: that of the search would be inaccurate.
    return jax.lax.custom_root(height, below, search, lambda slope, y: y / slope(jnp.ones_like(y)))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _by_jacobian(function: Callable[..., Any], *args: Any) -> Any:
    """Call a function, such as a loop of unknown length, that has forward derivatives only.

    Both forward and reverse derivatives become products with its Jacobian matrix.
    """
    return function(*args)


def _by_jacobian_jvp(function, args, changes):  # type: ignore[no-untyped-def]
    moved = [k for k, change in enumerate(changes) if not isinstance(change, SymbolicZero)]
    columns = jax.jacfwd(lambda *args: (value := function(*args), value), moved, has_aux=True)
    jacobian, values = _by_jacobian(columns, *args)
    tree: Any = jax.tree.structure(values)

    def product(of_each):  # type: ignore[no-untyped-def]
        pairs = zip(of_each, (changes[k] for k in moved), strict=True)
        return sum(jnp.tensordot(part, change, change.ndim) for part, change in pairs)

    return values, tree.unflatten(map(product, tree.flatten_up_to(jacobian)))


_by_jacobian.defjvp(_by_jacobian_jvp, symbolic_zeros=True)
