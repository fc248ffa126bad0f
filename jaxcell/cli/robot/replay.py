import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from ...base.formatting import configuration
from ..options import Printing
from ..terminal import say, table
from .recording import recording_of


if TYPE_CHECKING:
    from ...robot.outcome import RunOutcome
    from ...robot.run_log import LoggedRun
    from .emulation import Emulation


_SIDES = ("East", "North", "West", "South")


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotReplay(Printing):
    """Give what was run on a robot what the robot sensed then, and compare."""

    log: tyro.conf.Positional[Path]
    """The run.jsonl of `jaxcell robot run --out`."""
    file: Path | None = None
    """The filter or the patrol that was run, if it is no more where it was."""
    out: Path | None = None
    """Directory for a recording of the run, run.rrd, as of a robot that had no Rerun."""

    def run(self) -> int:
        from ...robot.run_log import read_log

        run = read_log(self.log)
        try:
            outcome = replayed(run, self.file)
        except KeyError as error:
            raise ValueError(f"{self.log}: line 1: {error} is missing") from error
        except ValueError as error:
            raise ValueError(f"{self.log}: {error}") from error
        if self.out is not None:
            self._record(run, self.out)
        summary = {"log": str(self.log), "whole": run.whole, **dataclasses.asdict(outcome)}
        if self.json:
            say(json.dumps(summary))
        else:
            show(self.log.name, summary)
        return 0

    def _record(self, run: "LoggedRun", out: Path) -> None:
        from ...robot.tasks.files import load_task

        path = Path(run.header["file"]) if self.file is None else self.file
        task = load_task(path, run.header.get("robot"))
        with recording_of(task, out / "run.rrd", start=run.header.get("pose")) as recording:
            for event in run.events:
                fields = {name: value for name, value in event.items() if name != "event"}
                recording.event(event["event"], fields)


def show(title: str, summary: dict[str, Any], emulation: "Emulation | None" = None) -> None:
    """Print the outcome of a run for people."""
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
    if emulation is None:
        rows += [("may be in", ", ".join(map(str, cells[:20])))] * bool(cells)
    else:
        truth, space = summary["emulated"], emulation.cells
        end = "no cell" if truth["end"] is None else configuration(space, truth["end"])
        rows += [("started at", configuration(space, truth["start"])), ("is at", end)]
        if cells:
            # A file of another map may end in a cell that the emulated map does not have.
            places = (
                configuration(space, z) if z < space.size else f"{z}, of another map"
                for z in cells[:8]
            )
            rows.append(("may be at", "\n".join(places)))
            among = "yes" if truth["truth_is_a_candidate"] else "NO"
            rows.append(("the truth is among them", among))
    table(title, ("", ""), rows)


def replayed(run: "LoggedRun", file: Path | None = None) -> "RunOutcome":
    """How a logged run ended, or stands, with what stopped it; `file` is what was run."""
    from ...robot.run_log import stopped

    return stopped(_replayed(run, file), run)


def _replayed(run: "LoggedRun", file: Path | None) -> "RunOutcome":
    from ...automata import Belief, Filter, HiddenMap, Policy
    from ...robot.anywhere import replay_anywhere
    from ...robot.believer import replay_belief
    from ...robot.patrol import replay_patrol
    from ...robot.policy import replay_policy
    from ...robot.runner import plan_outcome, replay_filter
    from ...robot.tasks.anywhere_task import AnywhereTask
    from ...robot.tasks.files import load_task
    from ...robot.tasks.patrol_task import PatrolTask
    from ...robot.tasks.task import digest
    from ...robot.team import replay_member

    kind = run.header["kind"]
    if kind == "plan":
        return plan_outcome(run.header["actions"], run.observations)
    if kind == "team":
        return replay_member(run)
    path = Path(run.header["file"]) if file is None else file
    if digest(path) != run.header["sha256"]:
        raise ValueError(f"it is of another {kind} than {path} is now")
    if kind == "filter":
        return replay_filter(run, Filter.load(path))
    if kind == "policy":
        return replay_policy(run, Policy.load(path))
    if kind == "belief":
        return replay_belief(run, Belief(HiddenMap.load(path)))
    if kind == "anywhere":
        task = load_task(path)
        assert isinstance(task, AnywhereTask)
        return replay_anywhere(run, task.settings)
    task = load_task(path, run.header["robot"])
    if not isinstance(task, PatrolTask):
        raise ValueError(
            f"kind: expected filter, policy, belief, plan, team or patrol, got {kind!r}"
        )
    return replay_patrol(run, task)
