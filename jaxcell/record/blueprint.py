"""What all recordings share: files, the map with y up, legends, and the frame of the viewer.

Rerun's plane has y down. Everything on a map is under the entity `map`, which turns y over, and is
logged in metres, y up. Pictures are under `map/grid`, which also stretches pixels to squares; their
first row is the lowest.
"""

import contextlib
import os
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import shapely
from jaxtyping import Float, Int, UInt8

from ..files import replacing
from ..space import CellSpace
from .canvas.palette import FREE, MARGIN, OBSTACLE, TEXT, WALL, LegendEntry, PictureClass


@contextlib.contextmanager
def recording(path: str | os.PathLike[str], kind: str) -> Iterator[rr.RecordingStream]:
    """A stream into a file, which appears when the block ends well, or not at all.

    Inside, bad arguments to Rerun raise.

    **Raises:** `ValueError` if the name does not end in `.rrd`, which the viewer asks for;
    `FileNotFoundError` if the folder does not exist; `OSError` if the disk is full.
    """
    if Path(path).suffix != ".rrd":
        raise ValueError(f"{path}: expected the name of a recording, which ends in .rrd")
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with replacing(path) as temporary:
            stream = new_stream(kind)
            # Rerun's own thread for files raises nothing when the disk is full.
            memory = stream.memory_recording()
            stream.send_recording_name(recording_name(path))
            yield stream
            temporary.write_bytes(memory.drain_as_bytes())
    finally:
        rr.set_strict_mode(strict)


def new_stream(kind: str) -> rr.RecordingStream:
    """A stream of its own application.

    The viewer keeps one blueprint for each application. Two recordings of one, opened side by side,
    would both have that of the last, and views of what is only in the other would be empty.
    """
    return rr.RecordingStream(f"jaxcell_{kind}_{uuid.uuid4().hex[:8]}")


def recording_name(path: str | os.PathLike[str]) -> str:
    """What the viewer calls a recording in its list: its folder and its own name."""
    path = Path(path).absolute()
    if path.parent == Path(os.path.expanduser("~")):
        return path.stem
    return f"{path.parent.name}/{path.stem}"


def send_blueprint(
    stream: rr.RecordingStream, layout: rrb.Container, timeline: str, speed: float
) -> None:
    """Fixes what the viewer shows: our views, and a timeline that plays, in steps a second."""
    play = rrb.TimePanel(timeline=timeline, fps=speed, play_state="playing", state="collapsed")
    stream.send_blueprint(fixed(layout, play))


def fixed(layout: rrb.Container, time: rrb.TimePanel) -> rrb.Blueprint:
    """What the viewer shows: our views only, and how time goes in them."""
    return rrb.Blueprint(
        layout,
        time,
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def log_map(stream: rr.RecordingStream, cells: CellSpace) -> None:
    """Logs free squares and walls, and turns y up for all that is under `map`."""
    stream.log("map", rr.Transform3D(scale=[1, -1, 1]), static=True)
    side = cells.cell
    stretch = rr.Transform3D(translation=[*cells.origin, 0], scale=[side, side, 1])
    stream.log("map/grid", stretch, static=True)
    classes = ("obstacle", OBSTACLE), ("free", FREE), ("too near a wall", MARGIN)
    log_classes(stream, "map/grid/free", [PictureClass(*one) for one in classes], order=-20.0)
    stream.log("map/grid/free", rr.SegmentationImage(_squares(cells)), static=True)
    stream.log(
        "map/walls",
        rr.LineStrips2D(_walls(cells), colors=WALL, radii=rr.Radius.ui_points(1.2), draw_order=10),
        static=True,
    )


def log_classes(
    stream: rr.RecordingStream, path: str, classes: Sequence[PictureClass], order: float = -10.0
) -> None:
    """Names and colours the classes of the pictures at a path; higher orders lie on top."""
    named = [(i, one.label, one.color) for i, one in enumerate(classes)]
    stream.log(path, rr.AnnotationContext(named), static=True)
    stream.log(path, rr.SegmentationImage.from_fields(opacity=1, draw_order=order), static=True)


def log_pictures(
    stream: rr.RecordingStream,
    path: str,
    timeline: str,
    times: Int[np.ndarray, "pictures"],
    pictures: UInt8[np.ndarray, "pictures rows columns"],
) -> None:
    """Logs a picture of classes for each time."""
    count, rows, columns = pictures.shape
    layout = rr.components.ImageFormat(width=columns, height=rows, channel_datatype="U8")
    stream.send_columns(
        path,
        [rr.TimeColumn(timeline, sequence=times)],
        rr.SegmentationImage.columns(buffer=pictures.reshape(count, -1), format=[layout] * count),
    )


def log_text(stream: rr.RecordingStream, path: str, text: str) -> None:
    """Logs a text in Markdown."""
    stream.log(path, rr.TextDocument(text, media_type="text/markdown"), static=True)


def map_view(cells: CellSpace, name: str, contents: Sequence[str]) -> rrb.Spatial2DView:
    """A view of entities on the map, with a margin around it."""
    left, bottom, right, top = bounds(cells)
    margin = 0.04 * max(right - left, top - bottom)
    return rrb.Spatial2DView(
        origin="/",
        name=name,
        contents=[f"+ /map/{one}" for one in ("walls", "grid/free", *contents)],
        background=OBSTACLE,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[left - margin, right + margin], y_range=[-top - margin, margin - bottom]
        ),
    )


def bounds(cells: CellSpace) -> tuple[float, float, float, float]:
    """The box around the squares of the cells, in metres: left, bottom, right, top."""
    rows, columns = cells.free.shape
    left, bottom = cells.origin
    return left, bottom, left + columns * cells.cell, bottom + rows * cells.cell


def extent(cells: CellSpace) -> float:
    """The larger side of the map: marks have at least a share of it, so that they can be seen."""
    left, bottom, right, top = bounds(cells)
    return max(right - left, top - bottom)


def log_legends(
    stream: rr.RecordingStream,
    path: str,
    timeline: str,
    times: Int[np.ndarray, "legends"],
    legends: Sequence[Sequence[LegendEntry]],
) -> None:
    """Logs a column of swatches with their meanings for each time."""
    index = [rr.TimeColumn(timeline, sequence=times)]
    lengths = [len(legend) for legend in legends]
    entries = [entry for legend in legends for entry in legend]
    row = np.array([entry.row for entry in entries], float)
    left = np.stack([np.zeros_like(row), row], axis=-1)
    right = left + np.array([0.5, 0])
    swatch = rr.LineStrips2D.columns(
        strips=np.stack([left, right], axis=1), colors=[entry.color for entry in entries]
    )
    stream.send_columns(f"{path}/swatch", index, swatch.partition(lengths))
    # The viewer writes a label centred under its point.
    text = rr.Points2D.columns(
        positions=right + np.array([5, -0.4]), labels=[entry.label for entry in entries]
    )
    stream.send_columns(f"{path}/text", index, text.partition(lengths))


def log_legend_style(stream: rr.RecordingStream, path: str) -> None:
    """Logs what all legends at a path have in common."""
    stream.log(f"{path}/swatch", rr.LineStrips2D.from_fields(radii=0.32), static=True)
    style = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True)
    stream.log(f"{path}/text", style, static=True)


def legend_view(path: str, rows: int) -> rrb.Spatial2DView:
    """A view of a legend of so many rows."""
    return rrb.Spatial2DView(
        origin=path,
        name="Legend",
        background=OBSTACLE,
        visual_bounds=rrb.VisualBounds2D(x_range=[-0.7, 10], y_range=[-0.8, rows - 0.2]),
    )


def _squares(cells: CellSpace) -> UInt8[np.ndarray, "rows columns"]:
    """0 for squares in an obstacle, 1 for free ones, 2 for those that are too near a wall."""
    squares = cells.free.astype(np.uint8)
    if cells.workspace is not None and cells.workspace.robot_radius > 0:
        row, column = np.nonzero(~cells.free)
        x = cells.origin[0] + (column + 0.5) * cells.cell
        y = cells.origin[1] + (row + 0.5) * cells.cell
        environment = cells.workspace.environment
        shapely.prepare(environment)
        inside = shapely.intersects_xy(environment, x, y)
        squares[row[inside], column[inside]] = 2
    return squares


def _walls(cells: CellSpace) -> list[Float[np.ndarray, "points 2"]]:
    """The edges of the environment, or of the free squares where there are only these."""
    if cells.workspace is not None:
        rings = shapely.get_rings(shapely.get_parts(cells.workspace.environment))
        return [shapely.get_coordinates(ring) for ring in rings]
    padded = np.pad(cells.free, 1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    level = np.stack([column, row, column + 1, row], axis=-1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack([column, row, column, row + 1], axis=-1)
    ends = np.concatenate([level, upright]).reshape(-1, 2, 2)
    return list(np.array(cells.origin) + ends * cells.cell)
