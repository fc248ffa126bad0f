import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .sines import with_sines


# Steps of a flow with crossing times where no cell is there to be crossed.
_LONG = 32

Point: TypeAlias = Float[Array, "axes"]
Field: TypeAlias = Callable[[Any, Any], Any]
"""The velocity at a point, `field(x, params)`."""


@runtime_checkable
class Map(Protocol):
    """A map of a space to itself: where a point goes next, `map(x, params)`.

    Any function of JAX that has a hash is one, such as one that is defined in a module. For stiff
    fields, a solve of diffrax with steps of its own choice:

        def stiff(x, params):
            term = diffrax.ODETerm(lambda t, y, p: field(y, p))
            control = diffrax.PIDController(rtol=1e-6, atol=1e-9)
            solver, times = diffrax.Kvaerno5(), (0.0, 1.0, 0.01)
            found = diffrax.diffeqsolve(
                term, solver, *times, x, params, stepsize_controller=control
            )
            return found.ys[-1]
    """

    def __call__(self, x: Any, params: Any, /) -> Any: ...


@dataclasses.dataclass(frozen=True)
class Flow:
    """What [`flow`][] gives: the map of a vector field over a time, by steps of fixed length."""

    field: Field
    dt: float
    steps: int
    "Steps of one application; with `crossing`, at most."
    crossing: int = 0
    "Cells that an image is away at least; 0 for the same number of steps everywhere."

    def __call__(self, x: Any, params: Any) -> Any:
        return self.ahead(x, params, self.usual)

    @property
    def usual(self) -> int:
        """Steps of an application, or some where cells have a number each."""
        return _LONG if self.crossing else self.steps

    def velocity(self, x: Any, params: Any) -> Any:
        """The field at a point."""
        return self.field(x, params)

    @property
    def duration(self) -> float | None:
        """The time of an application; none where cells have a time each."""
        return None if self.crossing else self.dt * self.steps

    def ahead(self, x: Any, params: Any, steps: Any, part: Any = 1.0) -> Any:
        """Some steps, of `dt` or a part of it."""
        return _advance(lambda _, y: self.field(y, params), x, 0.0, self.dt * part, steps)

    def one(self, x: Any, params: Any) -> Any:
        """One step."""
        return _rk4(lambda _, y: self.field(y, params), x, 0.0, self.dt)

    def halved(self) -> "Flow":
        """The same with steps of half the length."""
        return dataclasses.replace(self, dt=self.dt / 2, steps=2 * self.steps)


@dataclasses.dataclass(frozen=True)
class Strobe:
    """What [`strobe`][] gives: the map of a forced field over a period of the force."""

    field: Callable[[Any, Any, Any], Any]
    period: float
    steps: int

    def __call__(self, x: Any, params: Any) -> Any:
        def field(t, y):  # type: ignore[no-untyped-def]
            return self.field(t, y, params)

        return _advance(field, x, 0.0, self.period / self.steps, self.steps)

    def velocity(self, x: Any, params: Any) -> Any:
        """The field at a point, at phase 0."""
        return self.field(jnp.zeros(()), x, params)

    @property
    def duration(self) -> float:
        """The time of an application."""
        return self.period

    def halved(self) -> "Strobe":
        """The same with steps of half the length."""
        return dataclasses.replace(self, steps=2 * self.steps)


@dataclasses.dataclass(frozen=True)
class Section:
    """What [`section`][] gives: the map of a surface to itself along a flow."""

    flow: Flow
    surface: Callable[[Any, Any], Any]
    lift: Callable[[Any, Any], Any]
    project: Callable[[Any, Any], Any]
    max_steps: int

    def __call__(self, x: Any, params: Any) -> Any:
        return self.timed(x, params)[0]

    def timed(self, x: Any, params: Any) -> tuple[Any, Any]:
        """Where a point comes back to the surface, and when."""
        start = jnp.asarray(self.lift(x, params))

        def before(state):  # type: ignore[no-untyped-def]
            last, y, steps = state
            crossed = (self.surface(last, params) < 0) & (self.surface(y, params) >= 0)
            # The first step leaves the surface, where the sign of zero says nothing.
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
        """The field at a point of the surface."""
        return self.flow.field(jnp.asarray(self.lift(x, params)), params)

    def halved(self) -> "Section":
        """The same with steps of half the length."""
        half = dataclasses.replace(self.flow, dt=self.flow.dt / 2)
        return dataclasses.replace(self, flow=half, max_steps=2 * self.max_steps)


@dataclasses.dataclass(frozen=True)
class Impacts:
    """What [`impacts`][] gives: the map of a field with a reset wherever it meets a surface."""

    flow: Flow
    surface: Callable[[Any, Any], Any]
    reset: Callable[[Any, Any], Any]

    def __call__(self, x: Any, params: Any) -> Any:
        def field(_, y):  # type: ignore[no-untyped-def]
            return self.flow.field(y, params)

        def step(_, y):  # type: ignore[no-untyped-def]
            after = _rk4(field, y, 0.0, self.flow.dt)
            ends = -self.surface(y, params), -self.surface(after, params)
            hit = (ends[0] < 0) & (ends[1] >= 0)
            time = _crossing_time(
                lambda dt: -self.surface(_rk4(field, y, 0.0, dt), params), *ends, self.flow.dt
            )
            met = self.reset(_rk4(field, y, 0.0, time), params)
            return jnp.where(hit, _rk4(field, met, 0.0, self.flow.dt - time), after)

        return jax.lax.fori_loop(0, self.flow.steps, step, jnp.asarray(x))

    def velocity(self, x: Any, params: Any) -> Any:
        """The field at a point."""
        return self.flow.field(x, params)

    @property
    def duration(self) -> float | None:
        """The time of an application."""
        return self.flow.duration

    def halved(self) -> "Impacts":
        """The same with steps of half the length."""
        return dataclasses.replace(self, flow=self.flow.halved())


def flow(
    field: Field,
    dt: float,
    steps: int | Literal["crossing"] = "crossing",
    *,
    crossed: int = 16,
    max_steps: int = 1000,
) -> Flow:
    """The map of an autonomous field `x' = field(x, params)`, by Runge-Kutta steps of order 4.

    **Arguments:**

    - `field`: the velocity at a point, an array `[axes]`.
    - `dt`: length of a step in time.
    - `steps`: steps of one application. With `"crossing"` each cell has its own number: until its
        image is `crossed` cells away (after Hsu's criterion), so that slow cells are not their own
        images, and the error of half a cell that each image has is small beside the way.
    - `max_steps`: with `"crossing"`, the most steps; a cell whose image is not away by then holds
        an equilibrium, most likely.

    **Returns:** [`Flow`][jaxcell.dynamics.Flow], a [`Map`][jaxcell.dynamics.Map].

    Half a turn of a harmonic oscillator:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> turn = dynamics.flow(lambda x, p: jnp.array([x[1], -x[0]]), dt=jnp.pi / 100, steps=100)
        >>> np.allclose(jax.jit(turn)(np.array([1.0, 0.0]), {}), [-1, 0], atol=1e-5)
        True
    """
    _positive(dt=dt, crossed=crossed, max_steps=max_steps)
    if steps == "crossing":
        return Flow(field, float(dt), int(max_steps), crossing=int(crossed))
    _positive(steps=steps)
    return Flow(field, float(dt), int(steps))


def strobe(field: Callable[[Any, Any, Any], Any], period: float, steps: int) -> Strobe:
    """The map of a forced field over one period of the force, from phase 0.

    **Arguments:**

    - `field`: the velocity `field(t, x, params)`.
    - `period`: the time of one application.
    - `steps`: Runge-Kutta steps in it.

    **Returns:** a [`Map`][jaxcell.dynamics.Map].

    What a force adds in a period it takes away again:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> pushed = dynamics.strobe(lambda t, x, p: jnp.cos(t)[None], 2 * jnp.pi, steps=20)
        >>> np.allclose(jax.jit(pushed)(np.array([0.5]), {}), 0.5, atol=1e-6)
        True
    """
    _positive(period=period, steps=steps)
    return Strobe(field, float(period), int(steps))


def section(
    field: Field,
    surface: Callable[[Any, Any], Any],
    *,
    lift: Callable[[Any, Any], Any],
    project: Callable[[Any, Any], Any],
    dt: float,
    max_steps: int = 10_000,
) -> Section:
    """The return map of a flow to a surface that it crosses upwards.

    Steps go on until `surface` changes its sign from negative; the crossing is then found by the
    secant method within the step. A point that does not return in `max_steps` maps to NaN, which a
    box counts as `nowhere`.

    **Arguments:**

    - `field`: the velocity `field(x, params)`.
    - `surface`: `surface(x, params)`, zero on the surface.
    - `lift`: the point of the full space, `lift(u, params)`, of coordinates `u` on the surface.
    - `project`: the coordinates of a point of the surface.
    - `dt`: length of a step in time.
    - `max_steps`: the most steps to a return.

    **Returns:** a [`Map`][jaxcell.dynamics.Map] of coordinates on the surface.

    A spiral, which comes back to the positive x axis nearer to its centre by `exp(-pi / 5)`:

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
    _positive(dt=dt, max_steps=max_steps)
    return Section(Flow(field, float(dt), 1), surface, lift, project, int(max_steps))


def impacts(
    field: Field,
    surface: Callable[[Any, Any], Any],
    reset: Callable[[Any, Any], Any],
    *,
    dt: float,
    steps: int,
) -> Impacts:
    """The map of a flow over `steps` steps, with a reset where it meets a surface from above.

    At most one impact in a step is seen: a bouncing ball that comes to rest has many.

    **Arguments:**

    - `field`: the velocity `field(x, params)`.
    - `surface`: `surface(x, params)`, positive where the flow goes on, zero at an impact.
    - `reset`: where an impact leads, `reset(x, params)`.
    - `dt`, `steps`: length in time and number of the steps of one application.

    **Returns:** a [`Map`][jaxcell.dynamics.Map].

    A ball falls from 1 m, and leaves the ground with half its speed:

        >>> import jax, jax.numpy as jnp, numpy as np
        >>> from jaxcell import dynamics
        >>> ball = dynamics.impacts(
        ...     lambda x, p: jnp.array([x[1], -2.0]),
        ...     lambda x, p: x[0],
        ...     lambda x, p: jnp.array([0.0, -0.5 * x[1]]),
        ...     dt=0.15,
        ...     steps=10,
        ... )
        >>> np.allclose(jax.jit(ball)(np.array([1.0, 0.0]), {}), [0.25, 0], atol=1e-3)
        True
    """
    _positive(dt=dt, steps=steps)
    return Impacts(Flow(field, float(dt), int(steps)), surface, reset)


def _positive(**numbers: Any) -> None:
    for name, value in numbers.items():
        if not (isinstance(value, int | float) or hasattr(value, "__float__")) or not value > 0:
            raise ValueError(f"{name}: expected a number above 0, got {value!r}")


def _rk4(field: Callable[[Any, Any], Any], x: Any, t: Any, dt: Any) -> Any:
    # Components apart: a batch is then one array for each, which is what vector units read.
    start = tuple(x)

    # Traced once for all four.
    @jax.jit
    def slope(t: Any, at: tuple[Any, ...]) -> tuple[Any, ...]:
        found = jnp.asarray(with_sines(field)(t, jnp.stack(at)))
        if found.shape != (len(at),):
            raise ValueError(
                f"field: gives an array of shape {list(found.shape)} for a point of {[len(at)]}"
            )
        return tuple(found)

    def ahead(slopes: Sequence[Any], dt: Any) -> tuple[Any, ...]:
        return tuple(y + dt * one for y, one in zip(start, slopes, strict=True))

    # A number of Python has no width of its own, so that points of 32 bits stay so.
    one = slope(t, start)
    two = slope(t + dt / 2, ahead(one, dt / 2))
    three = slope(t + dt / 2, ahead(two, dt / 2))
    four = slope(t + dt, ahead(three, dt))
    mean = [a + 2 * b + 2 * c + d for a, b, c, d in zip(one, two, three, four, strict=True)]
    return jnp.stack(ahead(mean, dt / 6))


def _advance(field: Callable[[Any, Any], Any], x: Any, t: float, dt: Any, steps: Any) -> Any:
    def step(k, components):  # type: ignore[no-untyped-def]
        y = jnp.stack(components)
        return tuple(_rk4(field, y, t + dt * jnp.asarray(k, y.dtype), dt))

    start = tuple(jnp.asarray(x))
    return jnp.stack(jax.lax.fori_loop(0, steps, step, start))


def _crossing_time(height: Callable[[Any], Any], below: Any, above: Any, dt: float) -> Any:
    """When a height from `below` at 0 to `above` at `dt` is zero, by regula falsi (Illinois)."""

    def narrow(_, state):  # type: ignore[no-untyped-def]
        low, high, below, above = state
        # Equal heights happen where nothing is crossed; the time does not matter there.
        gap = jnp.where(above == below, 1.0, above - below)
        time = jnp.clip(high - above * (high - low) / gap, low, high)
        value = height(time)
        up = value >= 0
        return (
            jnp.where(up, low, time),
            jnp.where(up, time, high),
            jnp.where(up, below / 2, value),
            jnp.where(up, value, above / 2),
        )

    ends = jnp.zeros_like(below), jnp.full_like(below, dt)
    return jax.lax.fori_loop(0, 12, narrow, (*ends, below, above))[1]
