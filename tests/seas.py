"""Small seas, as `open_currents` gives them, and random ones for property tests."""

import numpy as np
import shapely
import xarray as xr
from hypothesis import strategies as st

from jaxcell.currents.land import read_land
from jaxcell.drift import Flow, SeaDrift, Water


def sea(east, north, wet=None, *, dx=1000.0, dy=1000.0, angle=0.0, hours=1.0):
    """Currents from the components `[rows, columns]`, `[times, rows, columns]`, or with layers."""
    east, north = np.asarray(east, float), np.asarray(north, float)
    if east.ndim == 2:
        east, north = east[None], north[None]
    if east.ndim == 3:
        east, north = east[:, None], north[:, None]
    times, layers, rows, columns = east.shape
    wet = np.ones((layers, rows, columns), bool) if wet is None else np.asarray(wet, bool)
    wet = np.broadcast_to(wet, (layers, rows, columns))
    start = np.datetime64("2011-07-01", "ns")
    step = np.timedelta64(round(hours * 3600), "s")
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    whole = np.ones((rows, columns))
    axes = ("time", "layer", "y", "x")
    return xr.Dataset(
        {
            "u": (axes, np.where(wet, east, np.nan)),
            "v": (axes, np.where(wet, north, np.nan)),
            "water": (axes[1:], wet),
            "dx": (axes[2:], dx * whole),
            "dy": (axes[2:], dy * whole),
            "angle": (axes[2:], angle * whole),
        },
        {
            "time": start + np.arange(times) * step,
            "depth": ("layer", 5.0 * np.arange(layers)),
            "lon": (axes[2:], -118 + column * 0.0107),
            "lat": (axes[2:], 33 + row * 0.009),
        },
    )


@st.composite
def seas(draw, steps=3.0):
    """A random current on a small grid with land; the drift of a second is some cells."""
    # Few shapes and numbers of cells, because JAX compiles once per shape.
    (rows, columns), dry = draw(
        st.sampled_from([((1, 5), 0), ((1, 5), 2), ((5, 6), 0), ((5, 6), 4), ((5, 6), 14)])
    )
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    wet = np.ones(rows * columns, bool)
    wet[random.permutation(wet.size)[:dry]] = False
    wet = wet.reshape(rows, columns)
    east, north = random.uniform(-steps, steps, (2, rows, columns))
    # Whole and half cells too, so that there are ties.
    if draw(st.booleans()):
        east, north = np.round(2 * east) / 2, np.round(2 * north) / 2
    dx, dy = draw(st.sampled_from([(1.0, 1.0), (2.0, 1.0), (1.0, 1.7)]))
    return sea(east * dx, north * dy, wet, dx=dx, dy=dy)


def double_gyre(rows=20, columns=40, inward=0.1):
    """Two gyres side by side, the left one clockwise, whose water goes slowly to their middles."""
    x = (np.arange(columns) + 0.5)[None] * 2 / columns
    y = (np.arange(rows) + 0.5)[:, None] / rows
    sign = np.sign(np.sin(np.pi * x))
    swirl = -np.sin(np.pi * x) * np.cos(np.pi * y), np.cos(np.pi * x) * np.sin(np.pi * y)
    sink = np.cos(np.pi * x) * np.sin(np.pi * y), np.sin(np.pi * x) * np.cos(np.pi * y)
    east, north = (a + inward * sign * b for a, b in zip(swirl, sink, strict=True))
    return sea(east, north)


def land_of_the_channel():
    """The bundled land near the Santa Barbara Channel."""
    near = shapely.box(-121, 33, -118, 35)
    return shapely.union_all(
        [polygon for polygon in read_land().polygons if polygon.intersects(near)]
    )


def water_and_flow(currents):
    """The water and the flow of the first layer."""
    return Water.of(currents), Flow.of(currents)


def drift_of(currents, step, *, goal=None, mean=True, **options):
    """The drift in currents, by default in their mean."""
    names = {"source": "sea.nc", "east_from": "u", "north_from": "v", "notes": ""}
    currents = currents.assign_attrs({**names, **currents.attrs})
    found = SeaDrift.of(currents, step, mean=mean, **options)
    return found if goal is None else found.towards(goal)
