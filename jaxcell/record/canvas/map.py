"""A map with y up, pictures of its cells, and views of it.

The plane of Rerun has y down. Entities on a map are below the entity `map`, which flips y; they are
logged in metres, with y up. Pictures are below `map/grid`, which also scales pixels to squares; the
first row of a picture is the lowest.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb
import shapely
from jaxtyping import Float, Int, Integer, UInt8

from ...space import CellSpace
from ...space.cells import along_grid, free_space_in_cells
from ...space.occupancy import in_squares, rasterise
from ...space.workspace import edges
from .marks import log_lines, points
from .palette import CLEAR, FREE, MARGIN, OBSTACLE, WALL, Color, PictureClass
from .stream import Dated, plane, send_changing, time_columns


_TOO_NEAR = "too near a wall", MARGIN
# Number of fine squares along the side of a cell that a wall cuts, and largest number on a map.
_FINE, _MAX_FINE = 8, 2**22
# Default number of corners of a trail; more corners would hide the map.
_CORNERS = 6
_Numbers: TypeAlias = Float[np.ndarray, "states"]
Poses: TypeAlias = tuple[_Numbers, _Numbers, _Numbers]
"""The x, the y and the heading of a robot at each time, in metres and radians."""


class CellMap:
    """The map of a cell space in a recording. The constructor logs its free squares and walls."""

    def __init__(self, stream: rr.RecordingStream, cells: CellSpace) -> None:
        self.stream, self.cells = stream, cells
        (rows, columns), (left, bottom) = cells.free.shape, cells.origin
        right, top = left + columns * cells.cell, bottom + rows * cells.cell
        self.bounds = left, bottom, right, top
        "The box around the squares of the cells, in metres."
        self.extent = max(right - left, top - bottom)
        "The larger side of the map, in metres. It limits how small marks are."
        self.arrow = max(0.8 * cells.cell, 0.045 * self.extent)
        "The length of the arrow of a robot, in metres, for a view of the whole map."
        self.frame = max(0.5 * cells.cell, 0.02 * self.extent)
        "Half the side of the frame around a square, in metres."
        stream.log("map", rr.Transform3D(scale=[1, -1, 1]), static=True)
        stream.log("map/grid", _stretch(cells, cells.cell), static=True)
        classes = ("obstacle", OBSTACLE), ("free", FREE), _TOO_NEAR
        named = [PictureClass(*one) for one in classes]
        log_pictures(stream, "map/grid/free", named, self._squares, order=-20.0)
        if self._sticks_out:
            fine, beyond = self._beyond()
            stream.log("map/beyond", _stretch(cells, fine), static=True)
            named = [PictureClass("within the walls", CLEAR), PictureClass(*classes[0])]
            log_pictures(stream, "map/beyond", named, beyond, order=-5.0)
        log_lines(stream, "map/walls", _walls(cells), WALL, 1.2, 10.0)

    @property
    def margin_legend(self) -> list[tuple[str, Color]]:
        """The legend of the grey squares between cells and walls; empty if there are none."""
        return [_TOO_NEAR] if (self._squares == 2).any() else []

    def xy(self, cell: Int[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 2"]:
        """Return the centres of cells or positions, in metres."""
        x, y, _ = self.cells.centre(cell)
        return np.stack([x, y], axis=-1)

    def below(
        self, place: Float[np.ndarray, "2"], gap: float
    ) -> tuple[Float[np.ndarray, "2"], Color]:
        """Return the point of a label `gap` metres below `place`, and the map's colour there."""
        at = place - np.array([0, gap])
        # The viewer draws a label below its place.
        under = at - np.array([0, 0.25 * self.cells.cell])
        column, row = np.floor((under - self.cells.origin) / self.cells.cell).astype(int)
        rows, columns = self.cells.free.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return at, FREE if inside and self.cells.free[row, column] else OBSTACLE

    def picture(
        self,
        name: str,
        classes: Sequence[PictureClass],
        kind: Integer[np.ndarray, "*pictures positions"],
        timeline: str | None = None,
        times: Int[np.ndarray, "pictures"] | None = None,
    ) -> str:
        """Log `kind`, the class of each position, as a picture or as one picture per time.

        The arguments are those of [`log_pictures`][].
        """
        pictures = on_squares(self.cells, kind)
        log_pictures(self.stream, f"map/grid/{name}", classes, pictures, timeline, times)
        return f"grid/{name}"

    def by_direction(
        self,
        name: str,
        classes: Sequence[PictureClass],
        kind: Integer[np.ndarray, "directions positions"],
        shown: "Directions",
    ) -> str:
        """Log `kind`, the class of each cell; `shown` gives the direction drawn at each time."""
        pictures, path = on_squares(self.cells, kind), f"map/grid/{name}"
        log_classes(self.stream, path, classes)
        for timeline, (times, directions) in shown.items():
            send_pictures(self.stream, path, pictures[directions], timeline, times)
        return f"grid/{name}"

    def frames(
        self,
        name: str,
        cells: Int[np.ndarray, "frames"],
        color: Color,
        times: Int[np.ndarray, "times"] | None = None,
        lengths: npt.ArrayLike | None = None,
        *,
        half: float | None = None,
        width: float = 2.5,
        order: float = 30.0,
    ) -> None:
        """Log frames around the squares of cells.

        With `times`, the frames change over the timeline `step`: `cells` contains the cells of the
        first time, then those of the next time, and so on; `lengths` has their number at each time.
        `half` is half the side of a frame, by default [`CellMap.frame`][].
        """
        path, centers = f"map/{name}", self.xy(cells)
        sizes = np.full(centers.shape, self.frame if half is None else half)
        boxes: dict[str, Any] = {"centers": centers, "half_sizes": sizes}
        style: dict[str, Any] = {"colors": color, "radii": points(width), "draw_order": order}
        if times is None:
            self.stream.log(path, rr.Boxes2D(**boxes, **style), static=True)
        else:
            send_changing(self.stream, path, rr.Boxes2D, times, lengths, style=style, **boxes)

    def robot(
        self,
        poses: Poses,
        color: Color,
        name: str = "",
        *,
        length: float | None = None,
        times: Int[np.ndarray, "times"] | None = None,
        trail_color: Color | None = None,
        corners: int = _CORNERS,
        width: float = 1.5,
        middle: float = 0.5,
        order: float = 30.0,
    ) -> None:
        """Log a robot as an arrow over the timeline `step`, and the trail behind it.

        **Arguments:**

        - `name`: the suffix of the names of the two entities, `robot` and `trail`.
        - `length`: the length of the arrow in metres, by default [`CellMap.arrow`][].
        - `times`: the indices of the shown poses; by default all poses.
        - `trail_color`: the colour of the trail, by default that of the robot.
        - `corners`: the largest number of corners of the trail.
        - `middle`: the share of the arrow behind the centre of the robot; with 0.5, the centre of
            the arrow is at the centre of the robot.
        - `order`: the drawing order of the robot; the trail lies below it.
        """
        x, y, theta = poses
        length = self.arrow if length is None else length
        times = np.arange(x.size) if times is None else times
        place = np.stack([x, y], axis=1)
        heading = length * np.stack([np.cos(theta), np.sin(theta)], axis=1)
        style = {"colors": color, "radii": length / 8, "draw_order": order}
        arrows = {"origins": place[times] - middle * heading[times], "vectors": heading[times]}
        path, trail = f"map/robot{name}", f"map/trail{name}"
        send_changing(self.stream, path, rr.Arrows2D, times, style=style, **arrows)
        corner = np.append(0, 1 + np.flatnonzero(np.diff(theta)))
        passed = np.searchsorted(corner, times, side="right").tolist()
        strips = [
            place[np.append(corner[max(0, past - corners) : past], time)]
            for time, past in zip(times.tolist(), passed, strict=True)
        ]
        style = {"colors": trail_color or color, "radii": points(width), "draw_order": order - 10}
        send_changing(self.stream, trail, rr.LineStrips2D, times, style=style, strips=strips)

    def view(self, title: str, contents: Sequence[str]) -> rrb.Spatial2DView:
        """Create a view of entities on the map, with a margin around it."""
        left, bottom, right, top = self.bounds
        margin = 0.04 * self.extent
        box = left - margin, -top - margin, right + margin, margin - bottom
        ground = ("walls", "beyond", "grid/free") if self._sticks_out else ("walls", "grid/free")
        shown = [f"/map/{one}" for one in (*ground, *contents)]
        return plane("/", title, box, shown, OBSTACLE)

    @functools.cached_property
    def _sticks_out(self) -> bool:
        """True if walls go through squares, so that free squares may extend beyond the walls."""
        cells = self.cells
        if cells.workspace is None:
            return False
        walls = edges(cells.workspace.environment)[:, 1:]
        return not along_grid(in_squares(walls, cells.origin, cells.cell))

    @functools.cached_property
    def _squares(self) -> UInt8[np.ndarray, "rows columns"]:
        """The class of each square: 0 in an obstacle, 1 free, 2 too near a wall."""
        cells = self.cells
        squares = cells.free.astype(np.uint8)
        if self._sticks_out:
            # The picture `map/beyond` covers the parts in obstacles.
            squares[squares == 0] = 2
        elif cells.workspace is not None and cells.workspace.robot_radius > 0:
            beyond = rasterise(cells.workspace.environment, self.bounds, cells.cell)
            squares[~cells.free & ~beyond] = 2
        return squares

    def _beyond(self) -> tuple[float, UInt8[np.ndarray, "rows columns"]]:
        """Divide the map into fine squares, and find the fine squares beyond the walls.

        If the map is an image, a pixel is split into whole fine squares, unless these are too many.

        **Returns:** the side of a fine square in metres, and a picture with 1 beyond the walls.
        """
        cells, room = self.cells, self.cells.room
        rows, columns = cells.free.shape
        pixel = room.cell or cells.cell
        side = pixel / math.ceil(_FINE * pixel / cells.cell)
        side = max(side, cells.cell * math.sqrt(rows * columns / _MAX_FINE))
        return side, rasterise(room.environment, self.bounds, side).astype(np.uint8)


Directions: TypeAlias = Mapping[str, tuple[Int[np.ndarray, "times"], Int[np.ndarray, "times"]]]
"""For each timeline, the times and the directions that pictures show at these times."""


def directions_shown(cells: CellSpace, path: Int[np.ndarray, "visits"] | None = None) -> Directions:
    """Choose the directions that pictures show over the timelines `direction` and `step`.

    The timeline `direction` contains all directions, and `step` contains the direction of a robot
    at each step. `path` contains the cells of the robot; without a path there is no timeline
    `step`.
    """
    every = np.arange(cells.directions)
    shown = {"direction": (every, every)}
    if path is not None:
        heading = path // cells.positions
        turns = np.flatnonzero(np.diff(heading, prepend=-1))
        shown["step"] = turns, heading[turns]
    return shown


def on_squares(
    cells: CellSpace, kind: Integer[np.ndarray, "*pictures positions"]
) -> UInt8[np.ndarray, "*pictures rows columns"]:
    """Arrange `kind`, the class of each position, as pictures; squares that are not free get 0."""
    pictures = np.zeros((*kind.shape[:-1], cells.free.size), np.uint8)
    pictures[..., cells.square] = kind
    return pictures.reshape(*kind.shape[:-1], *cells.free.shape)


def log_pictures(
    stream: rr.RecordingStream,
    path: str,
    classes: Sequence[PictureClass],
    pictures: UInt8[np.ndarray, "*pictures rows columns"],
    timeline: str | Dated | None = None,
    times: Int[np.ndarray, "pictures"] | None = None,
    order: float = -10.0,
) -> None:
    """Log a picture, or one picture per time; the pixels are indices of `classes`."""
    log_classes(stream, path, classes, order)
    if timeline is None or times is None:
        stream.log(path, rr.SegmentationImage(pictures), static=True)
    else:
        send_pictures(stream, path, pictures, timeline, times)


def log_classes(
    stream: rr.RecordingStream, path: str, classes: Sequence[PictureClass], order: float = -10.0
) -> None:
    """Log the labels and colours of the classes of a picture, and its drawing order."""
    named = [(i, one.label, one.color) for i, one in enumerate(classes)]
    stream.log(path, rr.AnnotationContext(named), static=True)
    stream.log(path, rr.SegmentationImage.from_fields(opacity=1, draw_order=order), static=True)


def send_pictures(
    stream: rr.RecordingStream,
    path: str,
    pictures: UInt8[np.ndarray, "pictures rows columns"],
    timeline: str | Dated,
    times: Int[np.ndarray, "pictures"],
) -> None:
    """Log one picture per time. The pixels are indices of classes, which [`log_classes`][] logs."""
    count, rows, columns = pictures.shape
    layout = rr.components.ImageFormat(width=columns, height=rows, channel_datatype="U8")
    stream.send_columns(
        path,
        time_columns(timeline, times),
        rr.SegmentationImage.columns(buffer=pictures.reshape(count, -1), format=[layout] * count),
    )


def _stretch(cells: CellSpace, side: float) -> rr.Transform3D:
    """Return the transform from pixels with sides of `side` metres to the map."""
    return rr.Transform3D(translation=[*cells.origin, 0], scale=[side, side, 1])


def _walls(cells: CellSpace) -> list[Float[np.ndarray, "points 2"]]:
    """Return the outlines of the environment or, if it is unknown, those of the free squares."""
    if cells.workspace is not None:
        area, corner, scale = cells.workspace.environment, np.zeros(2), 1.0
    else:
        area, corner, scale = free_space_in_cells(cells), np.array(cells.origin), cells.cell
    rings = shapely.get_rings(shapely.get_parts(area))
    return [corner + scale * shapely.get_coordinates(ring) for ring in rings]
