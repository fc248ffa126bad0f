import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from .robot_summary import show


if TYPE_CHECKING:
    from ..robot.outcome import RunOutcome
    from ..robot.run_log import LoggedRun


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotReplay:
    """Give what was run on a robot what the robot sensed then, and compare."""

    log: tyro.conf.Positional[Path]
    """The run.jsonl of `jaxcell robot run --out`."""
    file: Path | None = None
    """The filter or the patrol that was run, if it is no more where it was."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        from ..robot.run_log import read_log

        run = read_log(self.log)
        try:
            outcome = replayed(run, self.file)
        except KeyError as error:
            raise ValueError(f"{self.log}: line 1: {error} is missing") from error
        except ValueError as error:
            raise ValueError(f"{self.log}: {error}") from error
        summary = {"log": str(self.log), "whole": run.whole, **dataclasses.asdict(outcome)}
        if self.json:
            print(json.dumps(summary))
        else:
            show(self.log.name, summary)
        return 0


def replayed(run: "LoggedRun", file: Path | None = None) -> "RunOutcome":
    """How a logged run ended, or stands, with what stopped it; `file` is what was run."""
    from ..robot.run_log import stopped

    return stopped(_replayed(run, file), run)


def _replayed(run: "LoggedRun", file: Path | None) -> "RunOutcome":
    from ..automata import Filter
    from ..robot.patrol import replay_patrol
    from ..robot.patrol_task import PatrolTask
    from ..robot.runner import plan_outcome, replay_filter
    from ..robot.task import digest
    from ..robot.tasks import load_task
    from ..robot.team import replay_member

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
    task = load_task(path, run.header["robot"])
    if not isinstance(task, PatrolTask):
        raise ValueError(f"kind: expected filter, plan, team or patrol, got {kind!r}")
    return replay_patrol(run, task)
