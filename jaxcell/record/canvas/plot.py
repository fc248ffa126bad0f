"""Charts that are drawn in a plane, so that bars and curves lie over each other at all times.

The viewer's own charts show one kind of mark, or only what is on the timeline that plays.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .map import log_pictures
from .marks import log_labels, log_lines
from .palette import CLEAR, MARGIN, OBSTACLE, TEXT, Color, PictureClass


_WIDTH, _HEIGHT = 160.0, 90.0
# Of the picture of bars.
_ROWS = 512
_LEFT, _RIGHT, _BELOW, _ABOVE = 22.0, 8.0, 20.0, 12.0


@dataclasses.dataclass(frozen=True)
class Plot:
    """A chart with both axes from 0."""

    stream: rr.RecordingStream
    path: str
    most_x: float
    most_y: float

    def axes(
        self, x: Sequence[float | int], y: Sequence[float | int], about_x: str, about_y: str
    ) -> None:
        """Logs the axes with ticks at some numbers."""
        across, up = self._at(np.array(x, float), 0.0), self._at(0.0, np.array(y, float))
        lines = [np.array([[0, -_HEIGHT], [0, 0], [_WIDTH, 0]])]
        lines += [np.array([[at, 0], [at, 1.5]]) for at, _ in across]
        grid = [np.array([[0, at], [_WIDTH, at]]) for _, at in up if at]
        self._lines("axes", lines, TEXT, 1.0, 31.0)
        if grid:
            self._lines("grid", grid, MARGIN, 0.5, 1.0)
        labels = [(f"{one:g}", at, 6.0) for one, (at, _) in zip(x, across, strict=True)]
        labels += [(f"{one:g}", -8.0, at - 2.5) for one, (_, at) in zip(y, up, strict=True)]
        labels += [(about_x, _WIDTH / 2, 13.0), (about_y, 0.25 * _WIDTH, -_HEIGHT - 9.0)]
        log_labels(self.stream, f"{self.path}/labels", labels, order=40.0)

    def bars(
        self, name: str, heights: Float[np.ndarray, "bars"], last: float, color: Color
    ) -> None:
        """Logs bars of one width, side by side from 0 to a number."""
        path = f"{self.path}/{name}"
        # A picture, for the viewer does not fill boxes in a plane. Its first row is the highest.
        level = (np.arange(_ROWS, 0, -1) - 0.5) / _ROWS * self.most_y
        picture = (heights > level[:, None]).astype(np.uint8)
        classes = [PictureClass("", CLEAR), PictureClass(name, color)]
        log_pictures(self.stream, path, classes, picture)
        scale = [_WIDTH * last / self.most_x / heights.size, _HEIGHT / _ROWS, 1]
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
        """Logs a curve, over wider ones; what is not finite or above the chart is cut off."""
        shown = np.isfinite(y) & (x <= self.most_x)
        points = self._at(x[shown], np.minimum(y[shown], self.most_y))
        self._lines(name, [points], color, width, 30 - width)

    def marks(self, name: str, x: Sequence[float | int], color: Color) -> None:
        """Logs upright lines."""
        strips = [self._at(np.full(2, float(one)), np.array([0.0, self.most_y])) for one in x]
        self._lines(name, strips, color, 1.0, 5.0)

    def view(self, name: str) -> rrb.Spatial2DView:
        """A view of the chart."""
        return rrb.Spatial2DView(
            origin=self.path,
            name=name,
            background=OBSTACLE,
            visual_bounds=rrb.VisualBounds2D(
                x_range=[-_LEFT, _WIDTH + _RIGHT], y_range=[-_HEIGHT - _ABOVE, _BELOW]
            ),
        )

    def _at(
        self, x: Float[np.ndarray, "points"] | float, y: Float[np.ndarray, "points"] | float
    ) -> Float[np.ndarray, "points 2"]:
        across = np.atleast_1d(x) * (_WIDTH / self.most_x)
        up = np.atleast_1d(y) * (-_HEIGHT / self.most_y)
        return np.stack(np.broadcast_arrays(across, up), axis=1)

    def _lines(
        self, name: str, strips: Sequence[np.ndarray], color: Color, width: float, order: float
    ) -> None:
        log_lines(self.stream, f"{self.path}/{name}", strips, color, width, order)


def ticks(most: float | int, about: int = 5) -> list[float]:
    """Round numbers from 0 up to a number, about so many."""
    size = 10.0 ** np.floor(np.log10(most / about))
    step = next(size * one for one in (1, 2, 5, 10) if size * one * about >= most)
    return [float(one) for one in np.arange(int(most / step + 1e-9) + 1) * step]
