"""Simulate drifters, and follow policies, by other means than the maps that `drifters.py` checks.

Only the reader of the file is that of the library. Cells, interpolation, steps and distances are
those of this module.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse
import xarray as xr
from scipy.interpolate import NearestNDInterpolator
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.stats import wasserstein_distance

from jaxcell.drift import Sea, Voyage
from jaxcell.mapping import Chain


# Runge-Kutta steps in each step of a map.
FINE = 16


class Simulation:
    """Drifters in the current of a layer, at one record or at all records."""

    def __init__(self, currents: xr.Dataset, layer: int, record: int | None, wraps: bool) -> None:
        records = slice(None) if record is None else slice(record, record + 1)
        fields = currents.isel(layer=layer)
        self.wet, land = fields["water"].values, fields["land"].values
        self.gap, self.wraps = ~self.wet & ~land, wraps
        self.sides = np.stack([currents["dx"].values, currents["dy"].values])
        self.time = (currents["time"].values - currents["time"].values[0]) / np.timedelta64(1, "s")
        self.time = self.time[records]
        angle = currents["angle"].values
        velocity = (fields["u"].values + 1j * fields["v"].values)[records] * np.exp(-1j * angle)
        velocity = np.where(self.wet, velocity, 0)
        if self.gap.any():
            known = np.argwhere(self.wet)
            for one in velocity:
                one[self.gap] = NearestNDInterpolator(known, one[self.wet])(np.argwhere(self.gap))
        # Velocities in squares per second.
        self.rate = np.stack([velocity.real, velocity.imag], axis=1) / self.sides
        self.row, self.column = np.nonzero(self.wet)

    def velocity(self, x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        after = np.clip(np.searchsorted(self.time, time), 1, max(self.time.size - 1, 1))
        rate = self.rate[0]
        if self.time.size > 1:
            share = np.interp(time, self.time[after - 1 : after + 1], [0, 1])
            rate = (1 - share) * self.rate[after - 1] + share * self.rate[after]
        if self.wraps:
            rate, x = np.concatenate([rate, rate[..., :1]], axis=2), x % rate.shape[2]
        return np.stack([map_coordinates(one, [y, x], order=1, mode="nearest") for one in rate])

    def squares(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find the rows and columns of the squares of points, and which points are off the map."""
        rows, columns = self.wet.shape
        row, column = (np.floor(place + 0.5).astype(int) for place in (y, x))
        column = column % columns if self.wraps else column
        off = (row < 0) | (row >= rows) | (column < 0) | (column >= columns)
        row, column = row.clip(0, rows - 1), column.clip(0, columns - 1)
        return row, column, off | self.gap[row, column]

    def cells(self, x: np.ndarray, y: np.ndarray, gone: np.ndarray) -> np.ndarray:
        """Find the cells of points: on land the nearest cell, and -1 if a point is `gone`."""
        row, column, _ = self.squares(x, y)
        number = np.cumsum(self.wet.ravel()).reshape(self.wet.shape) - 1
        scale = self.sides.mean(axis=(1, 2))[:, None]
        tree = cKDTree((scale * [self.column, self.row]).T)
        _, nearest = tree.query((scale * [x, y]).T)
        cell = np.where(self.wet[row, column], number[row, column], nearest)
        return np.where(gone, -1, cell)

    def run(
        self,
        starts: Sequence[int],
        duration: float,
        steps: int,
        begin: float,
        rho: float,
        drifters: int,
        random: np.random.Generator,
    ) -> np.ndarray:
        """Simulate drifters from cells; return their cells, `[steps + 1, drifters]`.

        With probability `1 - rho` the drift of a step is turned by 45 degrees to either side.
        """
        origin = random.choice(starts, drifters)
        place = np.stack([self.column[origin], self.row[origin]]) + random.uniform(
            -0.5, 0.5, (2, drifters)
        )
        gone, cells, h = np.zeros(drifters, bool), [origin], duration / FINE
        turns = np.exp(1j * np.pi / 4 * np.array([0, 1, -1]))
        for step in range(steps):
            before = place
            for fine in range(FINE):
                now = begin + step * duration + fine * h
                a = self.velocity(*place, now)
                b = self.velocity(*(place + h / 2 * a), now + h / 2)
                c = self.velocity(*(place + h / 2 * b), now + h / 2)
                d = self.velocity(*(place + h * c), now + h)
                place = np.where(gone, place, place + h / 6 * (a + 2 * b + 2 * c + d))
                gone |= self.squares(*place)[2]
            row, column, _ = self.squares(*before)
            sides, way = self.sides[:, row, column], place - before
            turn = random.choice(turns, drifters, p=[rho, (1 - rho) / 2, (1 - rho) / 2])
            turned = (way[0] * sides[0] + 1j * way[1] * sides[1]) * turn
            place = before + np.stack([turned.real, turned.imag]) / sides
            gone |= self.squares(*place)[2]
            cells.append(self.cells(*place, gone))
        return np.stack(cells)


@dataclasses.dataclass(frozen=True, eq=False)
class Check:
    """The distributions by a map and of simulated drifters at some times."""

    name: str
    hours: list[float]
    by_map: np.ndarray
    simulated: np.ndarray
    wrong: list[float]
    "Total variation between both."
    noise: list[float]
    "Total variation between two halves of the drifters."
    apart: list[float]
    "The larger of the Wasserstein distances along x and y, in cells."

    @classmethod
    def of(
        cls, name: str, chain: Chain, simulation: Simulation, cell: np.ndarray, step: float,
        hours: Sequence[float],
    ) -> "Check":  # fmt: skip
        """Compare a map with simulated drifters, `cell[steps, drifters]`, after whole steps."""
        matrix, size = chain.to_scipy(), simulation.row.size

        def share(cells: np.ndarray) -> np.ndarray:
            return np.bincount(cells[cells >= 0], minlength=size) / cells.size

        def differ(p: np.ndarray, q: np.ndarray) -> float:
            return float(np.abs(p - q).sum() + abs(p.sum() - q.sum())) / 2

        numbers = [round(hour * 3600 / step) for hour in hours]
        pushed = [share(cell[0])]
        for _ in range(max(numbers)):
            pushed.append(matrix.T @ pushed[-1])
        by_map, simulated = ([of[n] for n in numbers] for of in (pushed, [*map(share, cell)]))
        apart = [
            max(
                wasserstein_distance(place, place, p, q)
                for place in (simulation.column, simulation.row)
            )
            if p.any() and q.any()
            else float("nan")
            for p, q in zip(by_map, simulated, strict=True)
        ]
        return cls(
            name,
            [n * step / 3600 for n in numbers],
            np.stack(by_map),
            np.stack(simulated),
            [differ(*both) for both in zip(by_map, simulated, strict=True)],
            [differ(share(cell[n, ::2]), share(cell[n, 1::2])) for n in numbers],
            apart,
        )


def arrival(sea: Sea, voyage: Voyage, water: np.ndarray, start: int, steps: int) -> float:
    """Compute the probability that a policy brings a drifter to its goal within some steps.

    The map of the drift, the goal and the actions are those of the voyage. `water` is the mask
    `[layers, rows, columns]` of the sea, from which this function finds the cells above and below.
    """
    number = np.where(water, np.cumsum(water.ravel()).reshape(water.shape) - 1, -1)
    layer, row, column = np.nonzero(water)
    action, goal = np.asarray(voyage.actions)[0], np.asarray(voyage.goal)
    to = number[layer + action, row, column]
    moves = (action != 0) & ~goal
    every = np.arange(goal.size)
    drifts = scipy.sparse.diags_array((~moves & ~goal).astype(float)) @ sea.drift.to_scipy()
    jumps = scipy.sparse.csr_array((moves * 1.0, (every, to)), shape=drifts.shape)
    matrix = drifts + jumps + scipy.sparse.diags_array(goal.astype(float))
    share = (every == start).astype(float)
    for _ in range(steps):
        share = matrix.T @ share
    return float(share[goal].sum())
