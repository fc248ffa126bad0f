import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Int
from scipy.ndimage import correlate1d, distance_transform_edt

from ..base.precision import require_x64
from ..base.shown import Shown
from ..base.wide import traced
from ..currents.sphere import turned
from .water import Water


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Flow(Shown):
    """The velocity of the water of one layer, in cells per second along the axes of the grid.

    The point `(x, y)` lies in column `x` and row `y` of the grid; integers are the centres of
    cells. On land the flow is 0, so that a drifter slows down towards a coast and does not cross
    it. If the coast is `"slip"`, the flow along the coast continues onto the land instead. Sea
    without data has the flow of the nearest cell, so that drifters leave through it.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> flow = drift.Flow.of(drift.open_currents(bundled("gyres"), time=0, depths=0))
        >>> flow.rate.shape, flow.time.tolist()
        ((1, 2, 21, 29), [0.0])
    """

    rate: Float[Any, "records axes rows columns"]
    "The velocities along x and y at the centres of the cells, in cells per second."
    time: Float[Any, "records"]
    "Seconds since the first record of the file, ascending."
    wraps: bool = dataclasses.field(default=False, metadata={"static": True})
    "True if the last column is beside the first, as in `Water`."
    period: Float[Any, ""] | None = None
    """Seconds from the first record to the last record, which repeats the first one; `None` if the
    current is not periodic."""
    diffusivity: float = dataclasses.field(default=0.0, metadata={"static": True})
    """The diffusivity of unresolved motion, in m²/s: over a time `t` drifters spread by
    `sqrt(2 diffusivity t)` along each axis."""

    @classmethod
    def of(
        cls,
        currents: xr.Dataset,
        layer: int = 0,
        record: int | None = None,
        *,
        diffusivity: float | int = 0.0,
        coast: str = "hold",
    ) -> "Flow":
        """Convert the velocities of one layer to a flow.

        **Arguments:**

        - `currents`: the currents, from [`jaxcell.drift.open_currents`][].
        - `layer`: number of the layer, from 0 at the surface.
        - `record`: index of the only record, for a steady flow; by default all records.
        - `diffusivity`: diffusivity of unresolved motion, in m²/s.
        - `coast`: the rule at a coast, as for [`Water.of`][].

        **Raises:** `ValueError` for a layer, record or diffusivity out of range.
        """
        require_x64("a flow")
        if not (np.isfinite(diffusivity) and diffusivity >= 0):
            raise ValueError(f"diffusivity: expected 0 m²/s or more, got {diffusivity}")
        water = Water.of(currents, layer, coast)
        records = currents.sizes["time"]
        if record is not None and not 0 <= record < records:
            raise ValueError(f"record {record} does not exist; there are {records}")
        taken = slice(None) if record is None else slice(record, record + 1)
        fields = currents.isel(layer=layer, time=taken)
        east, north = (
            np.where(water.number >= 0, np.asarray(fields[name], np.float64), 0) for name in "uv"
        )
        along_x, along_y = turned(east, north, -water.angle)
        since = (currents["time"].values - currents["time"].values[0]) / np.timedelta64(1, "s")
        rate = np.stack([along_x / water.dx, along_y / water.dy], axis=1)
        rate = jax.device_put(_extended(water, rate))
        return cls(rate, jax.device_put(since[taken]), water.wraps, diffusivity=float(diffusivity))

    @property
    def recorded(self) -> Float[Any, "records axes rows columns"]:
        """The rate at each record; in a periodic flow without the last, which repeats the first."""
        rate = self.rate if traced(self.rate) else np.asarray(self.rate)
        return rate if self.period is None else rate[:-1]

    def mean(self) -> "Flow":
        """Average the records into a steady flow."""
        mean = self.recorded.mean(axis=0, keepdims=True)
        rate, time = jax.device_put((mean, np.asarray(self.time)[:1]))
        return dataclasses.replace(self, rate=rate, time=time, period=None)

    def reversed(self) -> "Flow":
        """Reverse the flow in time, from the last record to the first.

        Drifters go back along the paths that brought them, so they end where they came from.
        Diffusion spreads them in the reversed flow, too: in incompressible water the probability of
        coming from a place equals the probability of going there in the reversed flow.
        """
        rate, time = np.asarray(self.rate), np.asarray(self.time)
        rate, time = jax.device_put((-rate[::-1], (time[0] + time[-1] - time)[::-1]))
        return dataclasses.replace(self, rate=rate, time=time)

    def repeated(self) -> "Flow":
        """Repeat the flow periodically after its last record; a steady flow is returned unchanged.

        The time from the last record to the first equals the time between the last two records.
        """
        rate, time = np.asarray(self.rate), np.asarray(self.time)
        if time.size < 2:
            return self
        end = 2 * time[-1] - time[-2]
        rate, time, period = jax.device_put(
            (np.append(rate, rate[:1], 0), np.append(time, end), np.float64(end - time[0]))
        )
        return dataclasses.replace(self, rate=rate, time=time, period=period)

    def fitted(self, duration: float | int) -> float:
        """Adjust a duration so that it divides the period, or is a multiple of the period.

        With steps of this duration the maps repeat after whole periods.
        """
        if self.period is None:
            return float(duration)
        length = float(self.period)
        if duration < length:
            return length / steps_in(length, duration)
        return length * steps_in(duration, length)

    def phases(self, duration: float | int) -> int:
        """Count the steps of length `duration` in a period; 1 if the flow is not periodic."""
        return 1 if self.period is None else steps_in(float(self.period), duration)


def _extended(
    water: Water, rate: Float[np.ndarray, "records axes rows columns"]
) -> Float[np.ndarray, "records axes rows columns"]:
    """Extend a flow to sea without data and, if the coast is `"slip"`, to land beside the water."""
    wet = water.number >= 0
    if (gaps := water.gaps).any():
        turns = 3 if water.wraps else 1
        away = np.tile(~wet, turns)
        row, column = distance_transform_edt(away, return_distances=False, return_indices=True)
        columns = wet.shape[1]
        middle = slice((turns // 2) * columns, (turns // 2 + 1) * columns)
        row, column = row[:, middle][gaps], column[:, middle][gaps] % columns
        rate[..., gaps] = rate[..., row, column]
    if water.coast == "slip":
        # The flow along x comes from water above and below, and the flow along y from water left
        # and right, so that no water crosses the coast.
        for axis, across in ((0, -2), (1, -1)):
            edge = "wrap" if water.wraps and across == -1 else "constant"
            total, count = (
                correlate1d(values, [1.0, 0.0, 1.0], axis=across, mode=edge)
                for values in (np.where(wet, rate[:, axis], 0.0), wet.astype(float))
            )
            rate[:, axis] = np.where(water.land, total / np.maximum(count, 1), rate[:, axis])
    return rate


def in_squares(flow: Flow, time: Float[Array, ""] | float) -> Float[Array, "axes squares"]:
    """Compute the flow in every square at a time, by linear interpolation between records.

    A flow that is not periodic is constant before the first record and after the last record.
    """
    records = flow.rate.shape[0]
    if flow.period is not None:
        time = flow.time[0] + (time - flow.time[0]) % flow.period
    if records == 1:
        along = flow.rate[0]
    else:
        after = jnp.clip(jnp.searchsorted(flow.time, time), 1, records - 1)
        before = after - 1
        share = (time - flow.time[before]) / (flow.time[after] - flow.time[before])
        share = jnp.clip(share, 0.0, 1.0)
        along = (1 - share) * flow.rate[before] + share * flow.rate[after]
    return along.reshape(2, -1)


def between(
    flow: Flow,
    rate: Float[Array, "axes squares"],
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Interpolate the flow at points bilinearly, from its rate in the squares.

    Points off the grid have the flow of the nearest point of the grid.
    """
    rows, columns = flow.rate.shape[2:]
    left, right, across = _neighbours(x, columns, flow.wraps)
    below, above, up = _neighbours(y, rows, False)

    low, high = below * columns, above * columns

    def value(field):  # type: ignore[no-untyped-def]
        # One index into all squares is faster than an index of rows and one of columns.
        near, far = (
            (1 - across) * field.at[row + left].get(mode="promise_in_bounds")
            + across * field.at[row + right].get(mode="promise_in_bounds")
            for row in (low, high)
        )
        return (1 - up) * near + up * far

    return value(rate[0]), value(rate[1])


def nearest_square(shape, wraps, x, y):  # type: ignore[no-untyped-def]
    """Find the row and column of the square of the grid that is nearest to each point."""
    rows, columns = shape
    row, column = (jnp.round(place).astype(jnp.int32) for place in (y, x))
    column = column % columns if wraps else jnp.clip(column, 0, columns - 1)
    return jnp.clip(row, 0, rows - 1), column


def steps_in(seconds: float | int, duration: float | int) -> int:
    """Return the number of steps whose total duration is nearest to `seconds`, at least 1."""
    return max(1, round(seconds / duration))


def _neighbours(
    coordinate: Float[Array, "*points"], size: int, wraps: bool
) -> tuple[Int[Array, "*points"], Int[Array, "*points"], Float[Array, "*points"]]:
    """Find the two cells around each coordinate on an axis, and the weight of the second cell."""
    if wraps:
        first = jnp.floor(coordinate)
        near = (first % size).astype(jnp.int32)
        return near, (near + 1) % size, coordinate - first
    coordinate = jnp.clip(coordinate, 0.0, size - 1.0)
    first = jnp.minimum(jnp.floor(coordinate), max(size - 2, 0))
    near = first.astype(jnp.int32)
    return near, jnp.minimum(near + 1, size - 1), coordinate - first


def crossing_time(water: Water, flow: Flow) -> Any:
    """Compute the time in seconds in which drifters move by one cell on average.

    The mean is over all cells and records. Alam 2018 takes steps "sufficiently long to cross a
    cell" but does not name the cell. In the time to cross the fastest cell, nearly all other cells
    are their own images. In the time to cross the slowest cell, drifters in fast cells cross the
    map.

    **Arguments:** the water and the flow of a layer, whose rate may be traced by `jit`, `vmap` and
    `grad`. **Returns:** the time, more than 0.

    At a mean speed of 0.54 m/s a drifter crosses a cell of a kilometre in half an hour:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> round(drift.crossing_time(water, flow) / 60)
        31
    """
    rate = flow.recorded
    xp = rate.__array_namespace__()
    here = rate[:, :, water.number >= 0]
    speed = xp.hypot(here[:, 0], here[:, 1])
    if traced(rate):
        return 1 / speed.mean()
    mean = float(speed.sum()) / speed.size
    if not mean > 0:
        raise ValueError("flow: the water stands still everywhere; expected some current")
    return 1 / mean
