"""The file of a recording, and what the viewer shows when it opens it."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from ...base.files import replacing


@contextlib.contextmanager
def recording(path: str | os.PathLike[str], kind: str) -> Iterator[rr.RecordingStream]:
    """Open a stream into a file, which appears when the block ends well, or not at all.

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
    """Make a stream of its own application.

    The viewer keeps one blueprint for each application. Two recordings of one, opened side by side,
    would both have that of the last, and views of what is only in the other would be empty.
    """
    return rr.RecordingStream(f"jaxcell_{kind}_{uuid.uuid4().hex[:8]}")


def recording_name(path: str | os.PathLike[str]) -> str:
    """What the viewer calls a recording in its list: its folder and its own name."""
    path = Path(path).absolute()
    return f"{path.parent.name}/{path.stem}"


def send_blueprint(
    stream: rr.RecordingStream, layout: rrb.Container, timeline: str, speed: float
) -> None:
    """Fix what the viewer shows: our views, and a timeline that plays, in steps a second."""
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
