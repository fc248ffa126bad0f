"""The file of a recording, and the layout of the viewer."""

import contextlib
import dataclasses
import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from ...base.paths import replacing
from ...base.results import current_run, shown_folder
from .palette import BLACK, Color


@contextlib.contextmanager
def recording(path: str | os.PathLike[str], kind: str) -> Iterator[rr.RecordingStream]:
    """Open a stream for a recording; write the file if the `with` block ends without an error.

    In the block, Rerun raises errors for bad arguments instead of printing warnings.
    """
    check_name(path)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with replacing(path) as temporary:
            stream = new_stream(kind)
            # The thread of Rerun for files does not raise an error if the disk is full.
            memory = stream.memory_recording()
            stream.send_recording_name(recording_name(path))
            if (run := current_run()) is not None:
                stream.send_property("run", rr.AnyValues(run_id=run))
            yield stream
            temporary.write_bytes(memory.drain_as_bytes())
    finally:
        rr.set_strict_mode(strict)


def check_name(path: str | os.PathLike[str]) -> None:
    """Raise `ValueError` if a path is not that of a recording."""
    if Path(path).suffix != ".rrd":
        raise ValueError(f"{path}: expected the name of a recording, which ends in .rrd")


def new_stream(kind: str) -> rr.RecordingStream:
    """Create a stream with a new application identifier.

    The viewer keeps one blueprint, or layout, per application. If two recordings had the same
    identifier, the first would be shown in the layout of the second, and its views would be empty.
    """
    return rr.RecordingStream(f"jaxcell_{kind}_{uuid.uuid4().hex[:8]}")


def recording_name(path: str | os.PathLike[str]) -> str:
    """Return the name that the viewer lists for a recording: its folder and its file name."""
    path = Path(path).absolute()
    return f"{shown_folder(path).name}/{path.stem}"


@dataclasses.dataclass(frozen=True)
class Dated:
    """A timeline that counts units of time, such as hours, from a date; the viewer shows dates."""

    unit: str
    start: np.datetime64
    seconds: int
    "Seconds per unit."
    name: ClassVar[str] = "date"


def time_columns(timeline: str | Dated, times: Int[np.ndarray, "times"]) -> list[rr.TimeColumn]:
    """Build the columns of a timeline: times, and for a dated timeline also dates."""
    if isinstance(timeline, str):
        return [rr.TimeColumn(timeline, sequence=times)]
    dates = timeline.start.astype("datetime64[ns]") + times * np.timedelta64(timeline.seconds, "s")
    units = rr.TimeColumn(timeline.unit, sequence=times)
    return [units, rr.TimeColumn(timeline.name, timestamp=dates)]


def send_changing(
    stream: rr.RecordingStream,
    path: str,
    archetype: Any,
    times: Int[np.ndarray, "times"],
    lengths: npt.ArrayLike | None = None,
    timeline: str | Dated = "step",
    /,
    *,
    style: Mapping[str, Any] | None = None,
    **columns: Any,
) -> None:
    """Log marks of one archetype, such as `rerun.Points2D`, that change at `times` of a timeline.

    `lengths` is the number of marks at each of the `times`, by default 1. `style` contains the
    components that do not change, and `columns` the other components, concatenated over all times.
    """
    index = time_columns(timeline, times)
    changing = archetype.columns(**columns)
    stream.send_columns(path, index, changing if lengths is None else changing.partition(lengths))
    if style is not None:
        stream.log(path, archetype.from_fields(**style), static=True)


def send_blueprint(
    stream: rr.RecordingStream, tabs: Sequence[rrb.Container], timeline: str | Dated, speed: float
) -> None:
    """Send the layout of the viewer: tabs, and a timeline that plays `speed` units per second."""
    layout = rrb.Tabs(*tabs, active_tab=0) if len(tabs) > 1 else tabs[0]
    play = rrb.TimePanel(
        timeline=timeline.name if isinstance(timeline, Dated) else timeline,
        fps=None if isinstance(timeline, Dated) else speed,
        playback_speed=speed * timeline.seconds if isinstance(timeline, Dated) else None,
        play_state="playing",
        state="collapsed",
    )
    stream.send_blueprint(fixed(layout, play))


def pace(steps: int) -> float:
    """Return the speed that plays all steps in 20 seconds, limited to 2 to 30 steps per second."""
    return float(np.clip(steps / 20, 2, 30))


def plane(
    origin: str,
    title: str,
    box: Sequence[float | int],
    contents: Sequence[str] | None = None,
    ground: Color = BLACK,
) -> rrb.Spatial2DView:
    """Create a view of a box in a plane with y down, in the coordinates of the entity `origin`.

    `box` contains the left, top, right and bottom of the box. `contents` lists the shown entities,
    by default all entities below `origin`; `ground` is the colour behind them.
    """
    left, top, right, bottom = box
    return rrb.Spatial2DView(
        origin=origin,
        name=title,
        contents="$origin/**" if contents is None else [f"+ {one}" for one in contents],
        background=ground,
        visual_bounds=rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom]),
    )


def fixed(layout: rrb.Container, time: rrb.TimePanel) -> rrb.Blueprint:
    """Create a blueprint of a layout and a time panel; the viewer adds no views of its own."""
    return rrb.Blueprint(
        layout,
        time,
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )
