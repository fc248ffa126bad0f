"""The outcome of a run: computed from its log, printed, and described in the folder of the run."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.documents import Fields
from ...base.formatting import configuration, percent
from ...base.paths import digest, name_in_results
from ...base.results import Manifest
from ...robot.anywhere import replay_anywhere
from ...robot.followers import replay_follower
from ...robot.outcome import RunOutcome
from ...robot.patrol import replay_patrol
from ...robot.plan import plan_outcome
from ...robot.run_log import LoggedRun, stopped
from ...robot.tasks.anywhere_task import AnywhereTask
from ...robot.tasks.files import BeliefTask, FilterTask, PolicyTask, load_task
from ...robot.tasks.patrol_task import PatrolTask
from ...robot.team import replay_member
from ...space import CellSpace
from ..output import Printing, option_words
from ..terminal import table
from .emulation import Emulation


LOG, RECORDING, SUMMARY = "run.jsonl", "run.rrd", "summary.json"
"""The names of the files of a run in its folder."""
ANYWHERE = ("confirm", "outliers", "restarts")
"""The options that replace settings of the task of a robot that starts anywhere."""
_FILES = (LOG, RECORDING, SUMMARY)
_COMMANDS = {"RobotRun": ("robot", "run"), "RobotReplay": ("robot", "replay")}
_SIDES = ("East", "North", "West", "South")


def show(
    title: str,
    summary: dict[str, Any],
    emulation: Emulation | None = None,
    own: CellSpace | None = None,
) -> None:
    """Print the outcome of a run as a table.

    `own` are the cells of the task, or `None` if its map is not found.
    """
    observed, cells = summary["observations"], summary["cells"]
    rows: list[tuple[str, object]] = [
        ("result", summary["result"]),
        ("why", summary["reason"]),
        ("observed", observed if len(observed) <= 60 else f"{observed[:57]}... ({len(observed)})"),
    ]
    if "visited" in summary:
        rows.append(("visited", f"{len(summary['visited'])} cells"))
    if summary.get("obstacles"):
        met = [f"{_SIDES[side]} of position {at}" for at, side in summary["obstacles"][:8]]
        rows.append(("in the way", "\n".join(met)))
    if summary.get("other_room_share") is not None:
        share, rooms = summary["other_room_share"], summary["other_rooms"]
        found = f"{percent(share)} of robots in {rooms or 'some'} random rooms"
        rows.append(("as sure elsewhere", found))
    if emulation is None:
        rows += [("may be in", ", ".join(f"cell {z}" for z in cells[:20]))] * bool(cells)
    else:
        truth, space = summary["emulated"], emulation.cells
        if "place" in summary:
            x, y, theta = emulation.pose
            ends = _pose(x, y, math.degrees(theta)), _pose(*truth["pose"])
        else:
            end = "no cell" if truth["end"] is None else configuration(space, truth["end"])
            ends = configuration(space, truth["start"]), end
        rows += zip(("started at", "is at"), ends, strict=True)
        if cells:
            places = (
                f"cell {z} of another map" if own is None else configuration(own, z)
                for z in cells[:8]
            )
            rows.append(("may be at", "\n".join(places)))
        if truth["truth_is_a_candidate"] is not None:
            among = "yes" if truth["truth_is_a_candidate"] else "NO"
            rows.append(("the truth is among them", among))
    table(title, ("", ""), rows)


def _pose(x: float, y: float, heading: float) -> str:
    """Format a pose in metres and degrees."""
    return f"({x:z.2f} m, {y:z.2f} m, {heading % 360:z.1f}°)"


def replayed(run: LoggedRun, file: Path | None = None) -> RunOutcome:
    """Compute the outcome of a logged run. `file`, if any, replaces the task file in the log."""
    return stopped(_replayed(run, file), run)


def _replayed(run: LoggedRun, file: Path | None) -> RunOutcome:
    kind, confirm = run.header["kind"], confirmed_by(run)
    if kind == "plan":
        return plan_outcome(run.header["actions"], run.observations)
    if kind == "team":
        return replay_member(run)
    path = Path(run.header["file"]) if file is None else file
    if digest(path) != run.header["sha256"]:
        raise ValueError(f"the log is of another {kind} than {path}")
    match load_task(path, run.header["robot"] if kind == "patrol" else None):
        case FilterTask() as task:
            until = run.header.get("until", "known")
            return replay_follower(run, task.follower(until, confirm=confirm))
        case PolicyTask() | BeliefTask() as task:
            return replay_follower(run, task.follower(confirm=confirm))
        case AnywhereTask() as task:
            fields = Fields(run.header, "")
            chosen: dict[str, Any] = {"confirm": 0}
            for name in ANYWHERE:
                if name in run.header:
                    chosen[name] = fields.whole(name, 0, 2**31)
            return replay_anywhere(run, dataclasses.replace(task.settings, **chosen))
        case PatrolTask() as task:
            return replay_patrol(run, task)
    raise ValueError(f"kind: expected filter, policy, belief, plan, team or patrol, got {kind!r}")


def describe(
    options: Printing, out: Path, *inputs: Path | None, used: Mapping[str, Any] | None = None
) -> None:
    """Write the manifest of the files of a run in `out`, which a command made from `inputs`.

    The values in `used` replace those of the options.
    """
    names = {field.name for field in dataclasses.fields(options)} - {"out", "json"}
    chosen = {
        name: name_in_results(value) if isinstance(value, Path) else value
        for name in sorted(names)
        if (value := getattr(options, name)) is not None
    }
    chosen |= used or {}
    known = {name_in_results(path): digest(path) for path in inputs if path and path.is_file()}
    words = [*_COMMANDS[type(options).__name__], *option_words(options, names, name_in_results)]
    manifest = Manifest.of(out, words, chosen, known)
    own = {name: value for name, value in manifest.files.items() if name in _FILES}
    dataclasses.replace(manifest, files=own).write(out)


def confirmed_by(run: LoggedRun) -> int:
    """Read the number of observations that confirm a robot; 0 in logs of earlier versions."""
    return Fields(run.header, "").whole("confirm", 0, 2**31) if "confirm" in run.header else 0
