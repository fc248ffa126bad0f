"""Marks, curves and legends for the recordings of robots that are localized."""

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, Int, Integer, UInt8

from ...bounce.localization.result import RunOnMap
from ..canvas.belief import MAX_ARROWS, log_beliefs, robot_length
from ..canvas.curves import curve
from ..canvas.map import CellMap, Poses
from ..canvas.marks import MAX_CORNERS, send_labels
from ..canvas.palette import BELIEF, CURRENT, KNOWN, ROBOT, TRAIL, Color
from ..canvas.prose import degrees
from ..canvas.stream import send_changing


# The margin around a graph, whose states are about 30 apart.
_MARGIN = 40
_MAX_OBSERVATIONS = 240
SEEN = f"""Press play, or drag `step` at the bottom.

- **vermilion arrow**: the true robot; the grey line is its trail.
- **blue arrows**: the cells where it may be; blue squares if there are more than {MAX_ARROWS:,}.
- **green squares**, at the end: the cells that are left."""


def run_legend(map: CellMap) -> list[tuple[str, Color]]:
    """Return the legend of the map on which a robot is localized."""
    return [
        ("the true robot", ROBOT),
        ("its trail", TRAIL),
        ("where it may be", BELIEF),
        ("left at the end", KNOWN),
        *map.margin_legend,
    ]


def observed(word: str) -> str:
    """Shorten a long string of observations; return "none" if it is empty."""
    return (word[:_MAX_OBSERVATIONS] + "..." * (len(word) > _MAX_OBSERVATIONS)) or "none"


def log_run(map: CellMap, poses: Poses, order: float = 18.0) -> None:
    """Log the true pose of a robot at each step, and its trail; `order` is the drawing order."""
    length, corners = robot_length(map), MAX_CORNERS
    map.robot(
        poses, ROBOT, length=length, trail_color=TRAIL, corners=corners, middle=0.0, order=order
    )


def log_candidates(map: CellMap, cells: Int[np.ndarray, "candidates"], time: int) -> None:
    """Log frames around the cells that are still possible at `time`, the end of a run."""
    few = cells[:MAX_ARROWS]
    map.frames("candidates", few, KNOWN, np.array([time]), [few.size])


def log_localized(
    map: CellMap,
    localized: RunOnMap,
    path: str,
    also: Sequence[str] = (),
    curves: Sequence[rrb.View] = (),
) -> rrb.Container:
    """Log a robot that is localized, the cells where it may be, and curves of their number.

    These curves are logged below the entity `path`. **Returns:** a map, which also shows the
    entities in `also`, above the curves; the views in `curves` are on the right of the curves.
    """
    run, stream, size = localized.run, map.stream, localized.belief_size
    log_beliefs(stream, localized.cells, localized.beliefs)
    log_run(map, (localized.robot_x, localized.robot_y, localized.robot_theta))
    last = run.observations.size
    log_candidates(map, run.candidates, last)
    at, ground = map.below(map.xy(run.path[-1:])[0], map.frame)
    end, labels = np.array([last]), ["the truth"]
    send_labels(stream, "map/truth", labels, end, ground=ground, positions=at[None])
    bits, most = np.log2(np.maximum(size, 1)), int(size.max())
    marks = ["grid/belief", "belief", "trail", "robot", "candidates", "truth", *also]
    numbers = (
        curve(stream, f"{path}/uncertainty", "Cells left", size, most, shape="Linear"),
        curve(stream, f"{path}/bits", "The same, log2", bits, shape="Linear"),
        log_bumps(stream, run.observations),
        *curves,
    )
    seen = map.view("Where the robot is, and where it may be", marks)
    return rrb.Vertical(seen, rrb.Horizontal(*numbers), row_shares=[7, 3])


def log_turns(
    map: CellMap,
    xy: Float[np.ndarray, "times 2"],
    turns: Bool[np.ndarray, "times"],
    angles: Sequence[float],
) -> None:
    """Log a label at each step where `turns` is true; `angles` lists these turns in radians."""
    bumps = np.flatnonzero(turns)
    labels = [f"bump {i}: turn by {degrees(angle)}" for i, angle in enumerate(angles, 1)]
    times, shown = np.arange(turns.size), turns.astype(int)
    send_labels(map.stream, "map/turn", labels, times, shown, positions=xy[bumps])


def log_bumps(stream: rr.RecordingStream, observations: Int[np.ndarray, "steps"]) -> rrb.View:
    """Log the number of bumps so far as a curve; an observation is 1 for a bump, otherwise 0."""
    # An observation is made at the end of a step, so a bump counts from the step before.
    bumps = np.append(0, np.cumsum(observations))
    path, title, most = "robot/bumps", "Bumps so far", int(bumps[-1])
    return curve(stream, path, title, bumps, most, color=ROBOT, shape="StepBefore")


def log_states(
    stream: rr.RecordingStream,
    path: str,
    title: str,
    names: dict[int, str],
    place: Float[np.ndarray, "states 2"],
    edges: Iterable[tuple[int, int]],
    size: Integer[np.ndarray, "states"],
    colors: UInt8[np.ndarray, "*#times states 3"],
    visited: Int[np.ndarray, "times"],
) -> rrb.View:
    """Log a graph of states, in which the visited state is highlighted at each step.

    `names` contains the text of each state, `place` its coordinates with y down, and `size` its
    number of cells. `visited` contains the state at each step.
    """
    drawn = np.array([*names])
    nodes = rr.GraphNodes.from_fields(
        node_ids=[*names.values()], positions=place, show_labels=False
    )
    stream.log(path, nodes, static=True)
    pairs = [(names[one], names[other]) for one, other in edges]
    stream.log(path, rr.GraphEdges(pairs, graph_type="directed"), static=True)
    here = visited[:, None] == drawn
    colors = np.where(here[..., None], np.array(CURRENT, np.uint8), colors)
    radii = 4 + 0.45 * np.log2(1 + size) + 5 * here
    times, lengths = np.arange(visited.size), [drawn.size] * visited.size
    columns = {"colors": colors.reshape(-1, 3), "radii": radii.ravel()}
    send_changing(stream, path, rr.GraphNodes, times, lengths, **columns)
    (left, top), (right, bottom) = place.min(axis=0) - _MARGIN, place.max(axis=0) + _MARGIN
    bounds = rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])
    return rrb.GraphView(origin=path, name=title, visual_bounds=bounds)
