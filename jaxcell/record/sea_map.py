"""What all maps of a sea share: land, the way to the North, a scale, and places on the grid.

Maps are drawn in the axes of the grid, in kilometres of its mean cell, so that a cell is a square
of a picture whichever way the grid is turned; an arrow says where North is.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, UInt8

from .blueprint import legend_view, log_classes, log_legend_style, log_legends
from .canvas.palette import FREE, OBSTACLE, PLAIN, TEXT, Color, LegendEntry, PictureClass
from .sea_drift import SeaDrift


LAND: Color = PLAIN
WATER: Color = FREE
_ONCE = np.zeros(1, np.int64)
# So many layers have maps of their own, from the surface down.
_MOST_MAPS = 6


# Pictures of moving drifters for each step of the chain, and how many at most.
_FRAMES_PER_STEP, _MOST_FRAMES = 4, 240
# So many steps of the chain are shown at least.
_LEAST_STEPS = 40
_UNITS = {"hour": 3600, "minute": 60, "second": 1}


@dataclasses.dataclass(frozen=True)
class Clock:
    """The timeline of a recording, in whole units from the first record."""

    unit: str
    "`hour`, `minute` or `second`."
    frame: int
    "Units from picture to picture."
    frames: int
    "Number of pictures after the first."

    @classmethod
    def of(cls, drift: SeaDrift) -> "Clock":
        """One that is fine enough for a step of the chain, and goes on to the last record."""
        last = float(drift.flows[0].time[-1] - drift.flows[0].time[0])
        total = max(last, _LEAST_STEPS * drift.duration)
        wanted = max(drift.duration / _FRAMES_PER_STEP, total / _MOST_FRAMES)
        unit = next((name for name, size in _UNITS.items() if wanted >= size), "second")
        frame = max(1, round(wanted / _UNITS[unit]))
        return cls(unit, frame, min(math.ceil(total / (frame * _UNITS[unit])), _MOST_FRAMES))

    @property
    def seconds(self) -> int:
        """The seconds of a unit."""
        return _UNITS[self.unit]

    @property
    def last(self) -> int:
        """The last time, in units."""
        return self.frame * self.frames

    @property
    def speed(self) -> float:
        """Units a second, so that all plays in about half a minute."""
        return max(1.0, self.last / 30)


@dataclasses.dataclass(frozen=True, eq=False)
class SeaMap:
    """Where things are on the maps of a sea, and when."""

    drift: SeaDrift

    @functools.cached_property
    def clock(self) -> Clock:
        """The timeline."""
        return Clock.of(self.drift)

    @property
    def layers(self) -> range:
        """The layers that have maps."""
        return range(min(len(self.drift.waters), _MOST_MAPS))

    @property
    def side(self) -> Float[np.ndarray, "axes"]:
        """The sides of the mean cell, in kilometres."""
        water = self.drift.waters[0]
        here = water.row, water.column
        return np.array([water.dx[here].mean(), water.dy[here].mean()]) / 1000

    @property
    def size(self) -> Float[np.ndarray, "axes"]:
        """The width and height of the map, in kilometres."""
        rows, columns = self.drift.waters[0].number.shape
        return np.array([columns, rows]) * self.side

    @property
    def extent(self) -> float:
        """The larger side of the map, in kilometres."""
        return float(self.size.max())

    @property
    def mark(self) -> float:
        """The radius of a mark that fills most of a cell, but can be seen on a large map."""
        return max(0.4 * float(self.side.min()), 0.004 * self.extent)

    def xy(
        self, column: Float[np.ndarray, "*points"], row: Float[np.ndarray, "*points"]
    ) -> Float[np.ndarray, "*points 2"]:
        """Places of the grid on the map, in kilometres."""
        return np.stack([column + 0.5, row + 0.5], axis=-1) * self.side

    def centres(
        self, layer: int, cells: Int[np.ndarray, "some"] | None = None
    ) -> Float[np.ndarray, "some 2"]:
        """The centres of cells of a layer, by default of all."""
        water = self.drift.waters[layer]
        some = np.arange(water.cells) if cells is None else cells
        return self.xy(water.column[some].astype(float), water.row[some].astype(float))

    def thinned(self, layer: int, most: int) -> Int[np.ndarray, "some"]:
        """Cells of a layer on a coarser grid, at most about so many."""
        water = self.drift.waters[layer]
        stride = max(1, math.ceil(math.sqrt(water.cells / most)))
        first = stride // 2
        return np.flatnonzero((water.row % stride == first) & (water.column % stride == first))

    def picture(self, layer: int, kind: UInt8[np.ndarray, "cells"]) -> rr.SegmentationImage:
        """Classes of the cells of a layer as a picture, with 0 for land."""
        return rr.SegmentationImage(self.drift.waters[layer].on_grid(kind, 0).astype(np.uint8))

    def view(self, name: str, contents: Sequence[str]) -> rrb.Spatial2DView:
        """A view of entities on the map, with the scale below it."""
        width, height = self.size.tolist()
        margin = 0.04 * self.extent
        return rrb.Spatial2DView(
            origin="/",
            name=name,
            contents=[f"+ /map/{one}" for one in ("frame/**", *contents)],
            background=OBSTACLE,
            visual_bounds=rrb.VisualBounds2D(
                x_range=[-margin, width + margin], y_range=[-height - margin, 2.6 * margin]
            ),
        )

    def depth(self, layer: int) -> str:
        """The depth of a layer, for titles."""
        return f"{self.drift.depths[layer]:g} m deep" if self.drift.depths[layer] else "Surface"


def log_sea_map(stream: rr.RecordingStream, sea: SeaMap) -> None:
    """Turns y up for all that is under `map`, and logs what is on every map."""
    stream.log("map", rr.Transform3D(scale=[1, -1, 1]), static=True)
    stream.log("map/grid", rr.Transform3D(scale=[*sea.side.tolist(), 1]), static=True)
    for layer in sea.layers:
        path = f"map/grid/water_{layer}"
        classes = [PictureClass("land", LAND), PictureClass("water", WATER)]
        log_classes(stream, path, classes, order=-20.0)
        wet = np.ones(sea.drift.waters[layer].cells, np.uint8)
        stream.log(path, sea.picture(layer, wet), static=True)
    _log_frame(stream, sea)


def _log_frame(stream: rr.RecordingStream, sea: SeaMap) -> None:
    """Logs a scale, an arrow to the North, and where the middle of the map is."""
    width = float(sea.size[0])
    margin = 0.04 * sea.extent
    low = -1.2 * margin
    length = round_below(0.25 * width)
    bar = rr.LineStrips2D(
        [[[0, low], [length, low]]], colors=TEXT, radii=rr.Radius.ui_points(1.5), draw_order=50
    )
    stream.log("map/frame/scale", bar, static=True)
    water = sea.drift.waters[0]
    angle = float(water.angle[water.row, water.column].mean())
    north = 1.5 * margin * np.array([math.sin(angle), math.cos(angle)])
    foot = np.array([0.42 * width, low]) - north / 2
    arrow = rr.Arrows2D(
        origins=[foot], vectors=[north], colors=TEXT, radii=0.1 * margin, draw_order=50
    )
    stream.log("map/frame/north", arrow, static=True)
    rows, columns = water.number.shape
    lon, lat = (float(one[rows // 2, columns // 2]) for one in (water.lon, water.lat))
    labels = [
        (f"{length:g} km", 0.5 * length, low),
        ("N", *(foot + 1.4 * north + [0, 0.4 * margin]).tolist()),
        (f"centre {place_name(lon, lat)}", 0.8 * width, low + 0.4 * margin),
    ]
    text = rr.Points2D(
        [(x, y) for _, x, y in labels],
        labels=[one for one, _, _ in labels],
        colors=TEXT,
        radii=0.001,
        show_labels=True,
        draw_order=60,
    )
    stream.log("map/frame/labels", text, static=True)


def log_marks(
    stream: rr.RecordingStream,
    path: str,
    xy: Float[np.ndarray, "marks 2"],
    radius: float,
    color: Color,
) -> None:
    """Logs round marks on the map."""
    marks = rr.Points2D(xy, colors=color, radii=radius, draw_order=40)
    stream.log(path, marks, static=True)


def log_legend(
    stream: rr.RecordingStream, sea: SeaMap, path: str, entries: Sequence[tuple[str, Color]]
) -> None:
    """Logs what colours mean."""
    log_legend_style(stream, path)
    legend = [LegendEntry(row, *entry) for row, entry in enumerate(entries)]
    log_legends(stream, path, sea.clock.unit, _ONCE, [legend])


def tab(name: str, views: Sequence[rrb.View], path: str, rows: int) -> rrb.Container:
    """Maps with the text and the legend that are at a path."""
    columns = math.ceil(math.sqrt(len(views)))
    text = rrb.TextDocumentView(origin=f"{path}/text", name="What you see")
    legend = legend_view(f"{path}/legend", rows)
    if len(views) % columns:
        # A place of the grid is left.
        maps = rrb.Grid(*views, legend, grid_columns=columns)
        return rrb.Horizontal(maps, text, column_shares=[7, 3], name=name)
    maps = rrb.Grid(*views, grid_columns=columns)
    return rrb.Horizontal(maps, legend, text, column_shares=[12, 4, 7], name=name)


def place_name(lon: float, lat: float) -> str:
    """A place as people read it."""
    east, north = "W" if lon < 0 else "E", "S" if lat < 0 else "N"
    return f"{abs(lat):.2f}° {north}, {abs(lon):.2f}° {east}"


def round_below(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a length."""
    size = 10.0 ** math.floor(math.log10(length))
    return next(size * one for one in (5, 2, 1) if size * one <= length * (1 + 1e-9))
