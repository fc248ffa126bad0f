"""Static charts with bars and curves, drawn in a plane.

The charts of the viewer itself show only data over a timeline, or only one kind of mark.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8

from .map import log_pictures
from .marks import log_labels, log_lines
from .palette import CLEAR, MARGIN, TEXT, Color, PictureClass
from .stream import plane


_WIDTH, _HEIGHT = 160.0, 90.0
# Height of the picture of bars, in pixels.
_ROWS = 512
_LEFT, _RIGHT, _BELOW, _ABOVE = 22.0, 8.0, 20.0, 14.0


Ticks: TypeAlias = Sequence[float | int] | Mapping[float, str]


@dataclasses.dataclass(frozen=True)
class Plot:
    """A chart whose axes extend from 0 to `most_x` and `most_y`."""

    stream: rr.RecordingStream
    path: str
    most_x: float
    most_y: float

    def axes(self, x: Ticks, y: Ticks, about_x: str, about_y: str) -> None:
        """Log the axes with titles; `x` and `y` list the ticks, or map the ticks to labels."""
        across, up = self.at(np.array([*x], float), 0.0), self.at(0.0, np.array([*y], float))
        lines = [np.array([[0, -_HEIGHT], [0, 0], [_WIDTH, 0]])]
        lines += [np.array([[at, 0], [at, 1.5]]) for at, _ in across]
        grid = [np.array([[0, at], [_WIDTH, at]]) for _, at in up if at]
        log_lines(self.stream, f"{self.path}/axes", lines, TEXT, 1.0, 31.0)
        if grid:
            log_lines(self.stream, f"{self.path}/grid", grid, MARGIN, 0.5, 1.0)
        labels = [(one, at, 6.0) for one, (at, _) in zip(_names(x), across, strict=True)]
        labels += [(one, -8.0, at - 2.5) for one, (_, at) in zip(_names(y), up, strict=True)]
        labels += [(about_x, _WIDTH / 2, 15.0), (about_y, 0.25 * _WIDTH, -_HEIGHT - _ABOVE)]
        log_labels(self.stream, f"{self.path}/labels", labels, order=40.0)

    def bars(
        self, name: str, heights: Float[np.ndarray, "bars"], last: float, color: Color
    ) -> None:
        """Log adjacent bars of equal width, from 0 to `last` on the x axis."""
        # Bars are a picture, because the viewer does not fill boxes in a plane.
        level = (np.arange(_ROWS) + 0.5) / _ROWS * self.most_y
        picture = (heights > level[:, None]).astype(np.uint8)
        classes = [PictureClass("", CLEAR), PictureClass(name, color)]
        self.picture(name, classes, picture, last)

    def picture(
        self,
        name: str,
        classes: Sequence[PictureClass],
        picture: UInt8[np.ndarray, "rows columns"],
        last: float,
        order: float = -10.0,
    ) -> None:
        """Log a picture as high as the chart, from 0 to `last` on the x axis; row 0 is lowest."""
        path, (rows, columns) = f"{self.path}/{name}", picture.shape
        log_pictures(self.stream, path, classes, picture[::-1], order=order)
        scale = [_WIDTH * last / self.most_x / columns, _HEIGHT / rows, 1]
        stretch = rr.Transform3D(translation=[0, -_HEIGHT, 0], scale=scale)
        self.stream.log(path, stretch, static=True)

    def line(
        self,
        name: str,
        x: Float[np.ndarray, "points"],
        y: Float[np.ndarray, "points"],
        color: Color,
        width: float,
    ) -> None:
        """Log a curve, drawn over wider curves. Values above the chart are drawn at its top."""
        shown = np.isfinite(y) & (x <= self.most_x)
        points = self.at(x[shown], np.minimum(y[shown], self.most_y))
        log_lines(self.stream, f"{self.path}/{name}", [points], color, width, 30 - width)

    def marks(self, name: str, x: Sequence[float | int], color: Color) -> None:
        """Log vertical lines from the bottom to the top of the chart."""
        strips = [self.at(np.full(2, float(one)), np.array([0.0, self.most_y])) for one in x]
        log_lines(self.stream, f"{self.path}/{name}", strips, color, 1.0, 5.0)

    def view(self, name: str, also: Sequence[str] = ()) -> rrb.Spatial2DView:
        """Create a view of the chart, and of the entities `also` in the same plane."""
        box = -_LEFT, -_HEIGHT - _ABOVE, _WIDTH + _RIGHT, _BELOW
        return plane("/", name, box, (f"/{self.path}/**", *also))

    def at(
        self, x: Float[np.ndarray, "points"] | float, y: Float[np.ndarray, "points"] | float
    ) -> Float[np.ndarray, "points 2"]:
        """Convert coordinates of the chart to points of the plane."""
        across = np.atleast_1d(x) * (_WIDTH / self.most_x)
        up = np.atleast_1d(y) * (-_HEIGHT / self.most_y)
        return np.stack(np.broadcast_arrays(across, up), axis=1)


def _names(ticks: Ticks) -> list[str]:
    return [*ticks.values()] if isinstance(ticks, Mapping) else [f"{one:zg}" for one in ticks]


def ticks(most: float | int, about: int = 5) -> list[float]:
    """Return round numbers from 0 to `most`, approximately `about` of them."""
    size = 10.0 ** np.floor(np.log10(most / about))
    step = next(size * one for one in (1, 2, 5, 10) if size * one * about >= most)
    return [float(one) for one in np.arange(int(most / step + 1e-9) + 1) * step]
