"""Maps of a sea, which also show its land and the parts without data.

Maps are drawn along the axes of the grid, in kilometres, as if all cells had the mean size. So each
cell is a pixel of a picture even if the grid is rotated; an arrow points north.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, Int, Integer
from scipy.ndimage import distance_transform_edt

from ...drift import CountedDrift, Dropped, Flow, Released, SeaDrift
from ...drift.results.layered_result import LayeredResult
from ..canvas.map import log_pictures
from ..canvas.marks import log_arrows, log_labels
from ..canvas.page import Legend, log_tab
from ..canvas.palette import CLEAR, FREE, OBSTACLE, PLAIN, TEXT, Color, PictureClass, mix
from ..canvas.scale import Scale
from ..canvas.stream import Dated, plane
from .frame import log_frame, round_below


LAND: Color = PLAIN
GAP: Color = mix(PLAIN, OBSTACLE, 0.75)
_GAP = "sea without data"
DRIFTER: Color = (20, 20, 24)
# The largest number of layers with a map, from the surface down.
_MAX_MAPS = 6
# Pictures of moving drifters per step of the chain, and the largest number of pictures.
_FRAMES_PER_STEP, _MAX_FRAMES = 4, 240
# The least number of steps of the chain that are shown.
_MIN_STEPS = 40
_UNITS = {"day": 86400, "hour": 3600, "minute": 60, "second": 1}


M = TypeVar("M", bound="SeaMap")


class Clock:
    """The timeline of a recording, which counts time from the start in a unit such as hours.

    The unit is short enough to show each step of the Markov chain, and the timeline is long
    enough to show all times of the currents.
    """

    def __init__(self, drift: LayeredResult | Released | Dropped | CountedDrift) -> None:
        total, start = _MIN_STEPS * drift.step, None
        if isinstance(drift, Released | Dropped | CountedDrift):
            total, start = 3600 * float(drift.hours[-1]), drift.on
        if isinstance(drift, SeaDrift):
            total = max(3600 * drift.covered_hours, total)
            if drift.until is not None:
                total = 3600 * drift.until
            # Drifters that go backward in time have no dates.
            start = None if drift.backward else drift.currents.time.values[0]
        wanted = max(drift.step / _FRAMES_PER_STEP, total / _MAX_FRAMES)
        self.unit = next((name for name, size in _UNITS.items() if wanted >= size), "second")
        self.seconds = _UNITS[self.unit]
        "Seconds per unit."
        self.frame = max(1, round(wanted / self.seconds))
        "Units between two pictures."
        self.frames = min(math.ceil(total / (self.frame * self.seconds)), _MAX_FRAMES)
        "Number of pictures after the first."
        self.last = self.frame * self.frames
        "The last time, in units."
        self.speed = max(1.0, self.last / 30)
        "The speed of playback in units per second, so that all of it takes about half a minute."
        dated = None if start is None else Dated(self.unit, start, self.seconds)
        self.timeline: str | Dated = dated or self.unit
        "The timeline of marks, of dates if they are known."


class SeaMap:
    """The map of a layer in a recording; layer 0 is at the surface."""

    dry: ClassVar[str] = "land"
    "The text in legends for the squares that are not cells."
    drift: Any
    "The result of the map: a `LayeredResult`, a `Released` or a `Dropped`."

    def __init__(
        self,
        stream: rr.RecordingStream,
        drift: LayeredResult | Released | Dropped | CountedDrift,
        clock: Clock,
        number: int,
    ) -> None:
        self.stream, self.drift, self.clock, self.number = stream, drift, clock, number
        self.water = drift.waters[number]
        self.title = f"{self.water.depth:g} m deep" if self.water.depth else "Surface"
        surface = drift.waters[0]
        here = surface.row, surface.column
        self.side = np.array([surface.dx[here].mean(), surface.dy[here].mean()]) / 1000
        "The sides of the mean cell, in kilometres."
        self.size = np.array(self.water.number.shape[::-1]) * self.side
        "The width and height of the map, in kilometres."
        self.extent = float(self.size.max())
        self.mark = max(0.4 * float(self.side.min()), 0.004 * self.extent)
        "The radius of a mark: most of a cell, but enough to be visible on a large map."

    def middle(self, cells: Bool[np.ndarray, "cells"]) -> tuple[float, float]:
        """Choose the position of the label of a set of cells, far from the edge of the set."""
        among = np.pad((self.water.number >= 0) & cells[self.water.number], 1)
        depth = distance_transform_edt(among)[1:-1, 1:-1][self.water.row, self.water.column]
        deepest = self.xy(np.flatnonzero(cells & (depth == depth.max())))
        away = np.linalg.norm(deepest - np.median(deepest, axis=0), axis=1)
        x, y = deepest[away.argmin()].tolist()
        return x, y

    def on_grid(
        self, column: Float[np.ndarray, "*points"], row: Float[np.ndarray, "*points"]
    ) -> Float[np.ndarray, "*points 2"]:
        """Convert columns and rows of the grid to positions on the map, in kilometres."""
        return np.stack([column + 0.5, row + 0.5], axis=-1) * self.side

    def xy(self, cells: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 2"]:
        """Return the centres of cells, in kilometres."""
        column, row = self.water.column[cells], self.water.row[cells]
        return self.on_grid(column.astype(float), row.astype(float))

    def picture(
        self,
        name: str,
        classes: Sequence[PictureClass],
        kind: Integer[np.ndarray, "*times cells"],
        order: float = -10.0,
        times: Int[np.ndarray, "times"] | None = None,
    ) -> str:
        """Log `kind`, the class of each cell, as one picture or one per time; class 0 is land.

        Sea without data gets an additional class. Returns the entity for [`SeaMap.view`][].
        """
        water = self.water
        squares = np.zeros((*kind.shape[:-1], *water.number.shape), np.uint8)
        squares[..., self.water.gaps] = len(classes)
        squares[..., water.row, water.column] = kind
        classes = [*classes, PictureClass(_GAP, CLEAR if order > -20 else GAP)]
        path, timeline = f"map/grid/{name}", self.clock.timeline
        log_pictures(self.stream, path, classes, squares, timeline, times, order)
        return f"grid/{name}"

    def numbers(
        self,
        name: str,
        title: str,
        scale: Scale,
        values: Float[np.ndarray, "cells"],
        special: Mapping[str, Bool[np.ndarray, "cells"]] | None = None,
    ) -> rrb.Spatial2DView:
        """Log a number per cell in the colours of a scale, and return a view of the picture.

        `special` is the argument of [`Scale.levels`][].
        """
        return self.view(title, [self.picture(name, scale.classes, scale.levels(values, special))])

    def view(self, title: str, contents: Sequence[str]) -> rrb.Spatial2DView:
        """Create a view of entities on the map, with the scale bar and the North arrow below it."""
        width, height = self.size.tolist()
        margin = 0.04 * self.extent
        shown = "frame/**", f"grid/water_{self.number}", *contents
        box = -2.6 * margin, -height - margin, width + margin, 3.6 * margin
        return plane("/", title, box, [f"/map/{name}" for name in shown])

    def tab(
        self, path: str, name: str, views: Sequence[rrb.View], text: str, legend: Legend
    ) -> rrb.Container:
        """Log the text and the legend of a tab, and return the tab with its views side by side."""
        legend = [*legend, (self.dry, LAND), *([(_GAP, GAP)] if self.water.gaps.any() else [])]
        return log_tab(self.stream, path, name, views, text, legend)


class CurrentMap(SeaMap):
    """The map of a layer and its current."""

    drift: SeaDrift

    @property
    def flow(self) -> Flow:
        return self.drift.layers[self.number].flow

    @functools.cached_property
    def arrow(self) -> float:
        """Scale of arrows: length in cells per unit of speed, for a mean length of 0.9 cells."""
        speeds = []
        for layer in self.drift.layers:
            rate = np.asarray(layer.flow.rate)[:, :, layer.water.number >= 0]
            speeds.append(np.hypot(rate[:, 0], rate[:, 1]))
        return 0.9 / float(np.concatenate([one[one > 0] for one in speeds]).mean())

    def log_key(self, spacing: float) -> None:
        """Log the key: an arrow with its speed. On the map, arrows are `spacing` cells apart."""
        # An arrow of one cell per second, in kilometres per m/s.
        length = self.arrow * spacing / 1000
        margin, width = 0.04 * self.extent, float(self.size[0])
        speed = round_below(0.2 * width / length)
        speed = min(speed, round_below(2.5 * spacing * float(self.side[0]) / length))
        foot = np.array([0.62 * width, -2.2 * margin])
        log_arrows(
            self.stream, "map/key/arrow", [foot], [[speed * length, 0.0]], TEXT,
            0.08 * spacing * float(self.side.min()), order=50.0,
        )  # fmt: skip
        middle = float(foot[0]) + speed * length / 2
        log_labels(self.stream, "map/key/speed", [(f"{speed:g} m/s", middle, float(foot[1]))])


def thinned(
    row: Int[np.ndarray, "squares"], column: Int[np.ndarray, "squares"], most: int
) -> tuple[Int[np.ndarray, "some"], int]:
    """Select every n-th of some squares along rows and columns, about `most`; return them and n."""
    stride = max(1, math.ceil(math.sqrt(row.size / most)))
    some = (row % stride == stride // 2) & (column % stride == stride // 2)
    return np.flatnonzero(some), stride


def shortened(
    vectors: Float[np.ndarray, "*arrows 2"], most: float
) -> Float[np.ndarray, "*arrows 2"]:
    """Shorten the arrows that are longer than `most`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1, most / np.maximum(length, 1e-12))


def log_maps(
    stream: rr.RecordingStream,
    drift: LayeredResult | Released | Dropped | CountedDrift,
    kind: type[M],
) -> list[M]:
    """Create a map of the class `kind` for each layer, and log its water and its frame."""
    clock = Clock(drift)
    count = min(len(drift.waters), _MAX_MAPS)
    maps = [kind(stream, drift, clock, number) for number in range(count)]
    stream.log("map", rr.Transform3D(scale=[1, -1, 1]), static=True)
    stream.log("map/grid", rr.Transform3D(scale=[*maps[0].side.tolist(), 1]), static=True)
    classes = [PictureClass(kind.dry, LAND), PictureClass("water", FREE)]
    for map in maps:
        wet = np.ones(map.water.cells, np.uint8)
        map.picture(f"water_{map.number}", classes, wet, order=-20.0)
    coastline = "" if isinstance(drift, LayeredResult) else drift.coastline
    if isinstance(drift, SeaDrift):
        coastline = drift.currents.attrs.get("coastline", "")
    log_frame(stream, maps[0].water, maps[0].side, coastline)
    return maps
