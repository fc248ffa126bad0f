import dataclasses
import functools
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Int

from ..base.precision import require_x64
from .water import Water


# For each stage of a method, how much of the step it is ahead, and its weight in the mean.
_STAGES = {
    "euler": ((0.0, 1.0),),
    "rk4": ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)),
}
METHODS = tuple(_STAGES)
# The longest step, and one over the shortest, in times to cross a cell.
_LONGEST = 1000

_Pair: TypeAlias = tuple[Array, Array]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Flow:
    """How fast the water of one layer goes, in cells per second along the axes of the grid.

    Cells are the unit because everything that follows is asked in places of the grid: the point
    `(x, y)` lies in column `x` and row `y`, whole numbers are the centres of cells. Without water
    the flow is 0, so that a drifter slows down towards a coast and does not cross it.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> flow = drift.Flow.of(drift.open_currents(bundled("gyres"), time=0, depths=0))
        >>> flow.rate.shape, flow.time.tolist()
        ((1, 2, 21, 29), [0.0])
    """

    rate: Float[Array, "records axes rows columns"]
    "Along x and y, at the centres of the cells."
    time: Float[Array, "records"]
    "Seconds since the first record of the file, ascending."
    wraps: bool = dataclasses.field(default=False, metadata={"static": True})
    "Whether the last column is beside the first, as in `Water`."
    period: Float[Array, ""] | None = None
    """Seconds from the first record to the last, which is the first again; `None` for a current
    that does not repeat."""
    diffusivity: float = dataclasses.field(default=0.0, metadata={"static": True})
    """In m²/s: what the current does not resolve spreads drifters over a time `t` by
    `sqrt(2 diffusivity t)` along each axis."""

    @classmethod
    def of(
        cls,
        currents: xr.Dataset,
        layer: int = 0,
        record: int | None = None,
        *,
        diffusivity: float | int = 0.0,
    ) -> "Flow":
        """The flow of one layer.

        **Arguments:**

        - `currents`: as from [`jaxcell.drift.open_currents`][].
        - `layer`: number of the layer, from 0 at the surface.
        - `record`: number of the record to take as steady; without it, all of them.
        - `diffusivity`: in m²/s, of what the current does not resolve.

        **Raises:** `ValueError` if there is no such layer or record, or for a diffusivity below 0;
        `RuntimeError` where JAX is set to 32 bits.
        """
        require_x64("a flow")
        if not (np.isfinite(diffusivity) and diffusivity >= 0):
            raise ValueError(f"diffusivity: expected 0 m²/s or more, got {diffusivity}")
        water = Water.of(currents, layer)
        records = currents.sizes["time"]
        if record is not None and not 0 <= record < records:
            raise ValueError(f"record {record} does not exist; there are {records}")
        taken = slice(None) if record is None else slice(record, record + 1)
        here = currents.isel(layer=layer, time=taken)
        east, north = (
            np.where(water.number >= 0, np.asarray(here[name], np.float64), 0) for name in "uv"
        )
        cos, sin = np.cos(water.angle), np.sin(water.angle)
        along_x = (east * cos + north * sin) / water.dx
        along_y = (north * cos - east * sin) / water.dy
        since = (currents["time"].values - currents["time"].values[0]) / np.timedelta64(1, "s")
        rate = jax.device_put(np.stack([along_x, along_y], axis=1))
        return cls(rate, jax.device_put(since[taken]), water.wraps, diffusivity=float(diffusivity))

    @property
    def recorded(self) -> Float[Array, "records axes rows columns"]:
        """The rate at each record, once."""
        return self.rate if self.period is None else self.rate[:-1]

    def mean(self) -> "Flow":
        """The steady flow that is the mean of the records."""
        mean = jnp.mean(self.recorded, axis=0, keepdims=True)
        return dataclasses.replace(self, rate=mean, time=self.time[:1], period=None)

    def reversed(self) -> "Flow":
        """The flow backward in time, from the last record to the first.

        Drifters go back along the ways that brought them: where they end is where they came from.
        What spreads them goes on to spread them, so that in water that is neither compressed nor
        drawn apart the chance to come from a place is that to go there.
        """
        time = (self.time[0] + self.time[-1] - self.time)[::-1]
        return dataclasses.replace(self, rate=-self.rate[::-1], time=time)

    def repeated(self, period: float | int | None = None) -> "Flow":
        """The flow that begins again after its last record; a steady one is itself.

        **Arguments:**

        - `period`: in seconds; by default, as if one more record followed the last at the same
            distance as the last two.

        **Raises:** `ValueError` for a period that ends before the last record.
        """
        time = np.asarray(self.time)
        if time.size < 2:
            return self
        length = float(2 * time[-1] - time[-2] - time[0] if period is None else period)
        if not (np.isfinite(length) and length > time[-1] - time[0]):
            raise ValueError(
                f"period: expected more than the {time[-1] - time[0]:g} s from the first record to "
                f"the last, got {length:g} s"
            )
        rate = jnp.concatenate([self.rate, self.rate[:1]])
        later = jnp.append(self.time, time[0] + length)
        return dataclasses.replace(self, rate=rate, time=later, period=jnp.float64(length))

    def fitted(self, duration: float | int) -> float:
        """The duration nearest to one of which the period is a whole multiple, or the other way
        round: by steps of that length all periods are alike."""
        if self.period is None:
            return float(duration)
        length = float(self.period)
        if duration < length:
            return length / steps_in(length, duration)
        return length * steps_in(duration, length)

    def at(
        self, x: Float[Array, "*points"], y: Float[Array, "*points"], time: Float[Array, ""]
    ) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
        """The flow at points of the grid, bilinear in place and linear in time.

        Off the grid it is that of the nearest point of the grid (columns that go round the Earth
        have no end), and before the first and after the last record that of these records, if it
        does not repeat.
        """
        records, _, rows, columns = self.rate.shape
        if self.period is not None:
            time = self.time[0] + (time - self.time[0]) % self.period
        if records == 1:
            along = self.rate[0]
        else:
            after = jnp.clip(jnp.searchsorted(self.time, time), 1, records - 1)
            before = after - 1
            share = (time - self.time[before]) / (self.time[after] - self.time[before])
            share = jnp.clip(share, 0.0, 1.0)
            along = (1 - share) * self.rate[before] + share * self.rate[after]
        left, right, across = (_around if self.wraps else _between)(x, columns)
        below, above, up = _between(y, rows)

        low, high = below * columns, above * columns

        def value(field):  # type: ignore[no-untyped-def]
            # By one index into all squares, which is faster than by two.
            near, far = (
                (1 - across) * field[row + left] + across * field[row + right]
                for row in (low, high)
            )
            return (1 - up) * near + up * far

        return value(along[0].ravel()), value(along[1].ravel())


def steps_in(seconds: float | int, duration: float | int) -> int:
    """Number of steps of a duration that is nearest to a time, of one at least."""
    return max(1, round(seconds / duration))


def _between(
    place: Float[Array, "*points"], size: int
) -> tuple[Int[Array, "*points"], Int[Array, "*points"], Float[Array, "*points"]]:
    """The cells on both sides of places on one axis, and how far towards the second they are."""
    place = jnp.clip(place, 0.0, size - 1.0)
    first = jnp.minimum(jnp.floor(place), max(size - 2, 0))
    near = first.astype(jnp.int32)
    return near, jnp.minimum(near + 1, size - 1), place - first


def _around(
    place: Float[Array, "*points"], size: int
) -> tuple[Int[Array, "*points"], Int[Array, "*points"], Float[Array, "*points"]]:
    """The same on an axis whose last cell is beside the first."""
    first = jnp.floor(place)
    near = (first % size).astype(jnp.int32)
    return near, (near + 1) % size, place - first


@functools.partial(jax.jit, static_argnames=("method", "steps"))
def advect(
    flow: Flow,
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
    duration: Float[Array, ""] | float,
    *,
    start: Float[Array, ""] | float = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Where the flow takes points of the grid. Works under `jit`, `vmap` and `grad`.

    **Arguments:**

    - `flow`: the flow.
    - `x`, `y`: the points, in cells.
    - `duration`: for how long, in seconds; backwards if negative.
    - `start`: when, in seconds as in `Flow.time`.
    - `method`: `"euler"`, Eq. 5.3 of Alam 2018, or `"rk4"`, the Runge-Kutta method of order 4.
    - `steps`: number of steps of the method.

    **Returns:** where the points are then, `x` and `y` in cells.

    **Raises:** `ValueError` for an unknown method, or fewer steps than 1.

    A flow of a tenth of a cell a second to the East, everywhere and always:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> rate = np.stack([np.full((3, 5), 0.1), np.zeros((3, 5))])[None]
        >>> flow = drift.Flow(rate, np.zeros(1))
        >>> x, y = drift.advect(flow, np.array([1.0]), np.array([2.0]), 20.0)
        >>> x.round(6).tolist(), y.tolist()
        ([3.0], [2.0])
    """
    _check_method(method, steps)
    length = duration / steps
    ahead, weight = (jnp.asarray(row, jnp.float64) for row in zip(*_STAGES[method], strict=True))
    share = length * weight / jnp.sum(weight)

    # A stage at a time, which adds what the one before has found: of more at once XLA would compute
    # early stages anew in the later ones.
    def stage(number, state):  # type: ignore[no-untyped-def]
        begun, reached, rates = state
        step, stage = number // ahead.size, number % ahead.size
        reached = _moved(reached, rates, share[stage - 1])
        begun = jax.tree.map(lambda new, old: jnp.where(stage, old, new), reached, begun)
        further = length * ahead[stage]
        now = start + step.astype(jnp.float64) * length + further
        x, y = _moved(begun, rates, further)
        return begun, reached, flow.at(x, y, now)

    begun = jnp.asarray(x, jnp.float64), jnp.asarray(y, jnp.float64)
    still = jnp.zeros_like(begun[0]), jnp.zeros_like(begun[1])
    state = jax.lax.fori_loop(0, ahead.size * steps, stage, (begun, begun, still))
    return _moved(state[1], state[2], share[-1])


def _moved(places: _Pair, rates: _Pair, time: Any) -> _Pair:
    return places[0] + time * rates[0], places[1] + time * rates[1]


def flow_map(
    water: Water,
    flow: Flow,
    duration: float | int | None = None,
    *,
    start: float | int = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> Float[Array, "axes cells"]:
    """How far the centre of every cell drifts (Alam 2018, section 5.4.2).

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `duration`: for how long, in seconds; backwards if negative. By default
        [`crossing_time`][].
    - `start`, `method`, `steps`: as for [`advect`][].

    **Returns:** the displacements along the axes x and y of the grid, in cells.

    **Raises:** `ValueError` for a duration that is 0 or not finite, an unknown method, or fewer
    steps than 1.

    In the time to cross a cell, cells drift by one on average:

        >>> import numpy as np
        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> shift = drift.flow_map(water, flow)
        >>> shift.shape, round(float(np.hypot(*np.asarray(shift)).mean()), 6)
        ((2, 538), 1.0)
    """
    duration = checked_duration(flow, water, duration, method, steps)
    places = np.stack([water.column, water.row]).astype(np.float64)
    ends = advect(flow, *places, float(duration), start=float(start), method=method, steps=steps)
    return jnp.stack(ends) - places


def crossing_time(water: Water, flow: Flow) -> float:
    """The time in seconds in which the mean drift over all cells and records is one cell.

    The source steps "sufficiently long to cross a cell" without saying which. With the time of the
    fastest cell nearly all others are their own images, and with that of the slowest the fastest
    jump over the map; so it is the mean here.

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.

    **Returns:** the time in seconds, more than 0.

    **Raises:** `ValueError` if the water stands still.

    At some 0.54 m/s it takes half an hour to cross a kilometre:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> round(drift.crossing_time(water, flow) / 60)
        31
    """
    rate = np.asarray(flow.recorded)
    speed = np.hypot(rate[:, 0], rate[:, 1])
    mean = float(speed.sum()) / (len(speed) * water.cells)
    if not mean > 0:
        raise ValueError("flow: the water stands still everywhere; expected some current")
    return 1 / mean


def check_step(duration: float | int | None, crossing: float) -> None:
    """Refuse steps in which nothing moves, and those that take for ever to follow.

    **Raises:** `ValueError` for a duration that is not 0.001 to 1000 times that to cross a cell.
    """
    least, most = crossing / _LONGEST, crossing * _LONGEST
    if duration is not None and not least <= duration <= most:
        raise ValueError(
            f"duration: expected {least:.3g} to {most:.3g} s, in which drifters go by "
            f"{1 / _LONGEST:g} to {_LONGEST:g} cells on average, got {duration:g}"
        )


def checked_duration(
    flow: Flow, water: Water, duration: float | int | None, method: str, steps: int
) -> float:
    """A duration in seconds, by default the time to cross a cell.

    **Raises:** as [`flow_map`][].
    """
    _check_method(method, steps)
    if flow.rate.shape[2:] != water.number.shape:
        raise ValueError(
            f"flow: expected one over the {list(water.number.shape)} squares of this water, got "
            f"one over {list(flow.rate.shape[2:])}"
        )
    if flow.wraps != water.wraps:
        raise ValueError(
            f"flow: wraps: expected {water.wraps} as for this water, got {flow.wraps}; only one of "
            "them goes round the Earth"
        )
    if duration is None:
        return crossing_time(water, flow)
    if not (np.isfinite(duration) and duration != 0):
        raise ValueError(f"duration: expected a number of seconds other than 0, got {duration}")
    return float(duration)


def _check_method(method: str, steps: int) -> None:
    if method not in METHODS:
        raise ValueError(f"method: expected 'euler' or 'rk4', got {method!r}")
    if steps < 1:
        raise ValueError(f"steps: expected 1 or more, got {steps}")
