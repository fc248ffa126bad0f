import dataclasses
from pathlib import Path
from typing import ClassVar

import tyro

from ..output import Printing


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotReplay(Printing):
    """Run a task again on the observations in a log, without a robot."""

    example: ClassVar[str] = "runs/emulated/run.jsonl"

    log: tyro.conf.Positional[Path]
    """The run.jsonl of `jaxcell robot run --out`."""
    file: Path | None = None
    """File of the task, if it was moved after the run."""
    out: Path | None = None
    """Folder for run.rrd, a recording of the run. This needs Rerun, which a robot may not have."""

    def run(self) -> int:
        from ...base.paths import digest, replacing
        from ...base.results import Manifest
        from ...robot import load_task, read_log
        from .outcome import LOG, RECORDING, describe, replayed, show
        from .recording import recording_of

        run = read_log(self.log)
        try:
            outcome = replayed(run, self.file)
        except KeyError as error:
            raise ValueError(f"{self.log}: line 1: {error} is missing") from error
        except ValueError as error:
            raise ValueError(f"{self.log}: {error}") from error
        if self.out is not None:
            before = Manifest.read(self.out)
            if before is not None:
                if digest(self.log) not in (before.files.get(LOG), *before.inputs.values()):
                    raise ValueError(f"--out {self.out}: it has the files of another run")
                if damaged := set(before.damage(self.out)) - {RECORDING}:
                    raise ValueError(f"--out {self.out}: damaged: {', '.join(sorted(damaged))}")
            path = Path(run.header["file"]) if self.file is None else self.file
            task, pose = load_task(path, run.header.get("robot")), run.header.get("pose")
            self.out.mkdir(parents=True, exist_ok=True)
            with (
                replacing(self.out / RECORDING) as file,
                recording_of(task, file, start=pose) as recording,
            ):
                for event in run.events:
                    fields = {name: value for name, value in event.items() if name != "event"}
                    recording.event(event["event"], fields)
            describe(self, self.out, self.log, path)
        summary = {"log": str(self.log), "whole": run.whole, **dataclasses.asdict(outcome)}
        self.report(summary, lambda: show(self.log.name, summary))
        return 0
