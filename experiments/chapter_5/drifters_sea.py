"""Read currents, and compute the long-term behaviour of their layers, for `drifters.py`."""

import argparse
import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxcell.base.certificate import Outcome
from jaxcell.drift import (
    Diagnosis,
    DriftStep,
    Flow,
    LongTermBehaviour,
    Sea,
    Water,
    crossing_time,
    diagnose,
    drift_map,
    long_term_behaviour,
    open_currents,
)
from jaxcell.mapping import Chain

from ..shared.data import DATA


GYRES = DATA / "ocean" / "gyres.nc"
GOAL = (-118.107, 33.472, 10.0)
# The source has three layers, of 0 to 10 m.
LAYERS, DEEPEST = 3, 10.0
YEAR = 24 * 365.25


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """A layer of the sea at one moment; its flow is steady, as in the dissertation."""

    water: Water
    flow: Flow
    duration: float
    "Seconds of a step."
    behaviour: LongTermBehaviour
    diagnosis: Diagnosis

    @classmethod
    def of(cls, water: Water, flow: Flow, duration: float | None, **options) -> "Layer":
        """Compute the behaviour of a layer.

        **Arguments:**

        - `duration`: seconds of a step; `None` for the time to cross a cell.
        - `options`: further parameters of `DriftStep`.
        """
        length = crossing_time(water, flow) if duration is None else duration
        chain = drift_map(water, flow, DriftStep(length, **options))
        behaviour = long_term_behaviour(chain, length)
        diagnosis = diagnose(water, flow, behaviour.groups, DriftStep(length))
        return cls(water, flow, length, behaviour, diagnosis)

    @property
    def chain(self) -> Chain:
        return self.behaviour.chain

    @property
    def group(self) -> np.ndarray:
        """The persistent group of each cell, -1 if it is transient."""
        return np.asarray(self.behaviour.groups.group)

    @property
    def transient(self) -> np.ndarray:
        """The transient group of each cell, -1 if it is persistent."""
        return np.asarray(self.behaviour.transient.group)

    @property
    def hours(self) -> np.ndarray:
        """Hours until a drifter from each cell is in a persistent group; NaN beyond 64 bits."""
        settled = self.behaviour.absorption.certificate.outcome is Outcome.CONVERGED
        return np.where(settled, np.asarray(self.behaviour.hours), np.nan)

    @property
    def held(self) -> int | None:
        """Number of transient cells with more than a year until a group, or `None` if unknown."""
        return None if np.isnan(self.hours).any() else int((self.hours > YEAR).sum())

    def homes(self, part: int) -> str:
        """Name the persistent groups to which a transient group leads, with numbers from 1."""
        homes = self.behaviour.transient.domiciles[part]
        if len(homes) > 3:
            return f"any of {len(homes)}"
        return " or ".join("off the grid" if home < 0 else str(home + 1) for home in homes)

    def cells_km(self) -> float:
        return float(np.sqrt(np.nanmean(self.water.dx * self.water.dy)) / 1000)


@dataclasses.dataclass(frozen=True, eq=False)
class Ocean:
    """Currents with the options of the experiment."""

    currents: xr.Dataset
    records: tuple[int, ...]
    "Numbers of the records in time; results for a single moment are for the first."
    starts: tuple[int, ...]
    "Cells of the surface where drifters are deployed."
    step: float | None
    "Seconds of a step; `None` for the time to cross a cell."
    rho: float
    spread: str

    @classmethod
    def of(cls, options: argparse.Namespace) -> "Ocean":
        """Read the file of the options.

        **Raises:** `ValueError` for an unsuitable file or place.
        """
        currents = open_currents(options.file, depths=options.depths)
        if options.depths is None:
            currents = currents.isel(layer=_some(currents["depth"].values))
        surface = Water.of(currents)
        starts = [surface.cell(*place) for place in options.start or _places(surface)]
        return cls(
            currents,
            _records(currents, options.hours),
            tuple(starts),
            None if options.step is None else 3600 * options.step,
            options.rho,
            options.spread,
        )

    @property
    def waters(self) -> list[Water]:
        return [Water.of(self.currents, k) for k in range(self.currents.sizes["layer"])]

    @property
    def first(self) -> np.ndarray:
        """The number of the first cell of each layer among all cells, and the number of cells."""
        return np.cumsum([0, *(water.cells for water in self.waters)])

    def hour(self, record: int) -> float:
        """Compute the hours of a record since the first one."""
        times = self.currents["time"].values
        return float((times[record] - times[0]) / np.timedelta64(1, "h"))

    def layer(self, record: int, layer: int = 0, **options) -> Layer:
        """Compute the behaviour of one layer; `options` replace those of the experiment."""
        water, flow = Water.of(self.currents, layer), Flow.of(self.currents, layer, record)
        return Layer.of(water, flow, self.step, **(self.mapping | options))

    def sea(self, record: int, **options) -> tuple[Sea, float]:
        """Join all layers, and return the seconds of a step: the mean over the layers."""
        waters = self.waters
        flows = [Flow.of(self.currents, k, record) for k in range(len(waters))]
        own = [crossing_time(water, flow) for water, flow in zip(waters, flows, strict=True)]
        step = float(np.mean(own)) if self.step is None else self.step
        chains = [
            drift_map(water, flow, DriftStep(step, **(self.mapping | options)))
            for water, flow in zip(waters, flows, strict=True)
        ]
        return Sea.of(waters, chains), step

    @property
    def mapping(self) -> dict:
        return {"rho": self.rho, "spread": self.spread}

    def cell(self, lon: float, lat: float, depth: float) -> int:
        """Find the number of a place among all cells, in the layer nearest to a depth."""
        layer = int(np.argmin(np.abs(self.currents["depth"].values - depth)))
        return int(self.first[layer]) + self.waters[layer].cell(lon, lat)

    def place(self, cell: int) -> str:
        """Write the longitude, latitude and depth of a cell as text."""
        layer = int(np.searchsorted(self.first, cell, side="right")) - 1
        water, at = self.waters[layer], cell - self.first[layer]
        row, column = water.row[at], water.column[at]
        return f"{water.lon[row, column]:.3f}, {water.lat[row, column]:.3f}, {water.depth:g} m"


def _some(depths: np.ndarray) -> np.ndarray:
    """Choose up to three layers, from the first to the last that is at most `DEEPEST`."""
    usable = max(1, int((depths <= DEEPEST).sum()))
    return np.unique(np.linspace(0, usable - 1, min(usable, LAYERS)).round().astype(int))


def _records(currents: xr.Dataset, hours: Sequence[float]) -> tuple[int, ...]:
    """Find the records nearest to some hours after the first record, without repetitions."""
    since = (currents["time"].values - currents["time"].values[0]) / np.timedelta64(1, "h")
    nearest = [int(np.abs(since - hour).argmin()) for hour in hours]
    return tuple(dict.fromkeys(nearest))


def _places(water: Water) -> list[tuple[float, float]]:
    """Choose a place in the middle of the western half of the water, and of the eastern half."""
    lon, lat = water.lon[water.row, water.column], water.lat[water.row, water.column]
    found = []
    for share in (0.25, 0.75):
        near = np.hypot(
            (lon - np.quantile(lon, share)) * np.cos(np.radians(lat)), lat - np.median(lat)
        )
        found.append((float(lon[near.argmin()]), float(lat[near.argmin()])))
    return found


def goal_of(ocean: Ocean) -> int:
    """Choose the default goal: the cell of the deepest layer with most drifters in the long run.

    In the synthetic sea it is a cell of the western basin, which drifters reach from both basins.
    """
    if ocean.currents.attrs["source"] == GYRES.name:
        return ocean.cell(*GOAL)
    last = len(ocean.waters) - 1
    share = np.asarray(ocean.layer(ocean.records[0], last).behaviour.limiting.value)
    return int(ocean.first[last] + share.argmax())


def double_gyre(rows: int = 20) -> tuple[Water, Flow]:
    """Make two gyres of opposite sense between coasts.

    This is the flow of Shadden, Lekien and Marsden (2005) without its oscillation, so no water
    crosses the line between the gyres. In addition, the water slowly moves to the centre of its
    gyre, so that each gyre collects its drifters.
    """
    columns, inward = 2 * rows, 0.3
    x = (np.arange(columns) + 0.5)[None] * 2 / columns
    y = (np.arange(rows) + 0.5)[:, None] / rows
    sin_x, cos_x, sin_y, cos_y = (f(np.pi * v) for v in (x, y) for f in (np.sin, np.cos))
    side = np.sign(sin_x)
    along_x = -sin_x * cos_y + inward * side * cos_x * sin_y
    along_y = cos_x * sin_y + inward * side * sin_x * cos_y
    cells = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    number = np.pad(cells, 1, constant_values=-1)
    nothing, side_m = np.zeros(number.shape), np.full(number.shape, 1000.0)
    water = Water(number, side_m, side_m, nothing, nothing, nothing, 0.0)
    # The fastest water moves at one metre per second.
    rate = np.pad(np.stack([along_x, along_y]), ((0, 0), (1, 1), (1, 1)))[None] / 1000
    return water, Flow(jnp.asarray(rate), jnp.zeros(1))
