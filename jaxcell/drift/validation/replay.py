"""Simulated drifters that begin on an even grid of points in cells."""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.shown import Shown
from ..advection import drifted, longest_step
from ..flow import Flow
from ..water import Water
from .simulated_drifters import total_variation


@dataclasses.dataclass(frozen=True)
class Sampling:
    """The points at which drifters begin: an even grid of points in each cell, or in some cells."""

    drifters: int = 1_000_000
    "The largest number of drifters."
    least: int = 3
    "The least number of points per side of a cell; if there are too many cells, some have none."
    most: int = 6
    "The largest number of points per side of a cell; doubled if drifters diffuse."
    part: int = 64
    "The side, in cells, of square blocks of the grid: all or none of their cells are sampled."
    moves: int = 100_000_000
    "The largest number of Runge-Kutta steps of all drifters together."


SAMPLING = Sampling()
"""The default sampling of [`distances`][jaxcell.drift.distances]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Replay(Shown):
    """Drifters that were simulated in the flow, with their cells at chosen times."""

    hours: Float[np.ndarray, "times"]
    "The times in hours, ascending."
    origin: Int[np.ndarray, "drifters"]
    "The cell in which each drifter began."
    cell: Int[np.ndarray, "times drifters"]
    "The cell of each drifter at each time; -1 if the drifter has left the grid."
    half: Bool[np.ndarray, "drifters"]
    "True for every second drifter from each cell; the two halves are compared to estimate noise."

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        hours: Sequence[float | int],
        sampling: Sampling = SAMPLING,
        cells: Int[np.ndarray, "releases"] | None = None,
    ) -> "Replay":
        """Simulate drifters with the Runge-Kutta method, plus a random walk with the diffusivity.

        By default 9 to 36 drifters begin in each cell, or up to 144 if they diffuse. If there are
        too many cells, drifters begin only in some square blocks of the grid.

        **Arguments:**

        - `water`, `flow`: the cells, and the flow of the same layer at all records.
        - `hours`: the times at which to record the cells of the drifters, in hours.
        - `sampling`: the points at which drifters begin.
        - `cells`: the only cells in which drifters begin.
        """
        times = np.unique(np.asarray(hours, float)) * 3600
        longest = longest_step(water, flow)
        most = min(sampling.drifters, int(sampling.moves / max(1.0, times[-1] / longest)))
        if cells is None:
            cells = np.flatnonzero(_sampled(water, dataclasses.replace(sampling, drifters=most)))
        densest = 2 * sampling.most if flow.diffusivity else sampling.most
        points = min(densest, max(sampling.least, math.isqrt(most // cells.size)))
        places = (np.arange(points) + 0.5) / points - 0.5
        right, up = (np.tile(offset.ravel(), cells.size) for offset in np.meshgrid(places, places))
        origin = np.repeat(cells, points**2)
        x, y = water.column[origin] + right, water.row[origin] + up
        cell, now, key = [], 0.0, jax.random.key(0)
        for time in times.tolist():
            key, drawn = jax.random.split(key)
            x, y = drifted(water, flow, x, y, now, time, longest, drawn)
            now = time
            cell.append(water.landing(x[None], y[None], origin=origin, exits=True)[0])
        row, column = (np.arange(points**2) // points, np.arange(points**2) % points)
        half = np.tile((row + column) % 2 == 0, cells.size)
        return cls(times / 3600, origin, np.stack(cell).astype(np.int32), half)

    def at(self, hours: float) -> Int[np.ndarray, "drifters"]:
        """Return the cells of the drifters at the time that is nearest to `hours`."""
        return self.cell[int(np.abs(self.hours - hours).argmin())]

    def share(
        self, hours: float, cells: int, among: Bool[np.ndarray, "drifters"] | None = None
    ) -> Float[np.ndarray, "cells"]:
        """Compute the share of the drifters, or of those in `among`, in each cell at a time."""
        cell = self.at(hours) if among is None else self.at(hours)[among]
        return np.bincount(cell[cell >= 0], minlength=cells) / cell.size

    def variation(
        self,
        hours: float,
        by_map: Float[np.ndarray, "cells"],
        among: Bool[np.ndarray, "drifters"] | None = None,
    ) -> tuple[float, float]:
        """Compute how far a map is from the drifters, or from those in `among`, at a time.

        **Returns:** the total variation, and the value to expect if the map were exact.
        """
        chosen = np.ones(self.origin.size, bool) if among is None else among
        drifters, *halves = (
            self.share(hours, by_map.size, chosen & part)
            for part in (chosen, self.half, ~self.half)
        )
        # The variance of each half is twice the variance of all drifters.
        return total_variation(by_map, drifters), total_variation(*halves) / 2

    def begin(self, cells: int) -> Float[np.ndarray, "cells"]:
        """Compute the share of the drifters that begin in each cell."""
        return np.bincount(self.origin, minlength=cells) / self.origin.size


def _sampled(water: Water, sampling: Sampling) -> Bool[np.ndarray, "cells"]:
    every = max(1, -(-water.cells * sampling.least**2 // max(1, sampling.drifters)))
    # Of the square parts along every row and column, one in `every` is chosen.
    part = water.row // sampling.part + water.column // sampling.part
    chosen = part % every == 0
    return chosen if chosen.any() else part == part[0]
