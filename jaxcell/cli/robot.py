import contextlib
import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from .options import cell_at, write_text
from .terminal import configuration, note, status, table


if TYPE_CHECKING:
    from ..record import RobotRecording
    from ..robot.emulator import Emulator
    from ..robot.runner import Outcome
    from ..robot.tasks import FilterTask, PlanTask
    from ..space import CellSpace


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotRun:
    """Run a localization filter or a plan on a robot, or on an emulated one in a map.

    The robot stops, and the run ends, at Ctrl-C."""

    file: tyro.conf.Positional[Path]
    """What to run: the filter.jxf of `jaxcell localize --out`, or the summary.json of `jaxcell
    navigate --out`."""
    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    simulate: Path | None = None
    """Map in which to emulate the robot instead; it may be another than that of the file."""
    start: str | None = None
    """Start of the emulated robot: "x,y,heading" in m and degrees, or a cell; by default that of
    the plan, or random."""
    heading: float | None = None
    """Heading of the robot at the start in degrees, where steps in some directions are longer than
    in others; the filter is not told. By default that of the plan or the emulated robot; without
    any, all steps are of one length."""
    noise: float = 0.0
    """Standard deviation of the relative error of the emulated robot's steps and turns, and of its
    veer in radians a metre."""
    speedup: float = 10.0
    """Seconds of the emulated robot in a second."""
    seed: int = 0
    """Seed of the random start and of the noise."""
    limit: int = 10_000
    """Observations after which to give up."""
    out: Path | None = None
    """Directory for the log, which must not be there yet, the recording and summary.json."""
    live: str | None = None
    """Viewer that shows the recording as the run goes: "here", or the address of one, such as
    rerun+http://laptop:9876/proxy."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        import numpy as np

        from ..robot import Create, RobotStopped
        from ..robot.tasks import load_task

        if (self.port is None) == (self.simulate is None):
            raise ValueError("expected one of --port and --simulate")
        if self.live is not None and self.out is None:
            raise ValueError("--live: expected --out as well, for the recording")
        task = load_task(self.file)
        rng = np.random.default_rng(self.seed)
        emulation = None if self.simulate is None else _emulation(self, task, rng)
        heading = self._heading(task, emulation)
        # Before the robot is there: what it needs takes seconds to load.
        recording = None if self.out is None else self._recording(task, emulation)
        try:
            with contextlib.ExitStack() as stack:
                port = self.port
                if emulation is not None:
                    port = stack.enter_context(emulation.robot).port
                assert port is not None
                robot = stack.enter_context(Create.open(port))
                robot.arm()
                outcome = self._run(robot, task, heading, recording)
        except RobotStopped as error:
            note(f"jaxcell robot run: the robot was stopped: {error}")
            return 1
        summary = {"file": str(self.file), "port": self.port, **dataclasses.asdict(outcome)}
        if emulation is not None:
            summary["emulated"] = emulation.describe(outcome)
        if self.out is not None:
            write_text(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        if self.json:
            print(json.dumps(summary))
        else:
            show(self.file.name, summary, emulation)
        return 0 if outcome.result in ("localized", "arrived") else 1

    def _heading(self, task: "FilterTask | PlanTask", emulation: "_Emulation | None") -> int | None:
        """The direction at the start, where it is known."""
        from ..robot.tasks import PlanTask

        if self.heading is not None:
            direction = self.heading * task.directions / 360
            if abs(direction - round(direction)) > 1e-6:
                raise ValueError(
                    f"--heading {self.heading:g}: expected a multiple of the "
                    f"{360 / task.directions:g} degrees between the directions"
                )
            return round(direction) % task.directions
        if emulation is not None:
            return emulation.start // emulation.cells.positions
        if isinstance(task, PlanTask):
            raise ValueError("--heading: a plan needs the heading that its robot starts with")
        return None

    def _recording(
        self, task: "FilterTask | PlanTask", emulation: "_Emulation | None"
    ) -> "RobotRecording":
        from ..record import RecordedRobot, RobotRecording
        from ..robot.tasks import FilterTask

        assert self.out is not None
        self.out.mkdir(parents=True, exist_ok=True)
        filter = task.filter if isinstance(task, FilterTask) else None
        about = {} if filter is None else filter.metadata
        cells = _cells_of(task, about) if emulation is None else emulation.cells
        robot = RecordedRobot()
        if emulation is not None:
            x, y, theta = emulation.cells.centre(emulation.start)
            start = float(x), float(y), float(theta)
            robot = RecordedRobot(start=start, trace=emulation.robot.trace)
        same = cells is not None and _is_map(cells, about)
        return RobotRecording(
            self.out / "run.rrd",
            [robot],
            cells=cells,
            filter=filter if same else None,
            viewer=self.live,
            spec={"file": str(self.file), **about},
        )

    def _run(
        self,
        robot: Any,
        task: "FilterTask | PlanTask",
        heading: int | None,
        recording: "RobotRecording | None",
    ) -> "Outcome":
        from ..robot.run_log import RunLog
        from ..robot.runner import run_filter, run_plan
        from ..robot.tasks import FilterTask
        from ..robot.walker import Walker

        log: RunLog | None = None
        if self.out is not None:
            # First, for it refuses to replace what is there.
            log = RunLog(self.out / "run.jsonl", task.header)
        strides = None if heading is None else task.strides
        walker = Walker(robot, task.step, strides=strides, direction=heading or 0)
        with contextlib.ExitStack() as stack:
            if log is not None and recording is not None:
                stack.enter_context(recording)
                log.on_event = recording.event
                stack.enter_context(log)
            stack.enter_context(status(f"running {self.file.name}"))
            if isinstance(task, FilterTask):
                return run_filter(walker, task.filter, task.bounce, log=log, limit=self.limit)
            return run_plan(walker, task.actions, log=log)


@dataclasses.dataclass(frozen=True)
class _Emulation:
    """An emulated robot, and the cells of its map."""

    robot: "Emulator"
    cells: "CellSpace"
    start: int

    @property
    def end(self) -> int | None:
        """The cell that the robot is in, if any."""
        with contextlib.suppress(ValueError):
            return int(self.cells.index(*self.robot.pose))
        return None

    def describe(self, outcome: "Outcome") -> dict[str, Any]:
        """The truth, for the summary."""
        x, y, theta = self.robot.pose
        return {
            "start": self.start,
            "end": self.end,
            "pose": [round(x, 4), round(y, 4), round(math.degrees(theta) % 360, 2)],
            "seconds": round(self.robot.seconds, 2),
            "truth_is_a_candidate": self.end in outcome.cells if outcome.cells else None,
        }


def _cells_of(task: "FilterTask | PlanTask", about: Mapping[str, Any]) -> "CellSpace | None":
    """The cells of the map that a filter is of, if the map is where it was."""
    from ..space import CellSpace, Workspace

    with contextlib.suppress(OSError, ValueError, KeyError):
        workspace = dataclasses.replace(Workspace.load(about["map"]), robot_radius=task.radius)
        cells = CellSpace.of(workspace, task.cell, task.directions)
        return cells if _is_map(cells, about) else None
    return None


def _is_map(cells: "CellSpace", about: Mapping[str, Any]) -> bool:
    """Whether cells are those of the map that a filter is of, by what it says."""
    assert cells.workspace is not None
    found = {
        "name": cells.workspace.name,
        "positions": cells.positions,
        "robot_radius_m": cells.workspace.robot_radius,
    }
    return all(about.get(key, value) == value for key, value in found.items())


def _emulation(options: RobotRun, task: "FilterTask | PlanTask", rng: Any) -> _Emulation:
    from ..robot.body import Body, Noise
    from ..robot.emulator import Emulator, Line
    from ..robot.tasks import PlanTask
    from ..space import CellSpace, Workspace

    assert options.simulate is not None
    workspace = dataclasses.replace(Workspace.load(options.simulate), robot_radius=task.radius)
    cells = CellSpace.of(workspace, task.cell, task.directions)
    if options.start is not None:
        start = cell_at(cells, options.start, "--start")
    elif isinstance(task, PlanTask):
        start = cell_at(cells, str(task.start), f"{options.file}: start")
    else:
        start = int(rng.integers(cells.size))
    x, y, theta = cells.centre(start)
    noise = Noise(distance=options.noise, rotation=options.noise, veer=options.noise)
    body = Body(workspace, (float(x), float(y), float(theta)), noise=noise, rng=rng)
    return _Emulation(Emulator(body, line=Line(speedup=options.speedup)), cells, start)


def show(title: str, summary: dict[str, Any], emulation: _Emulation | None = None) -> None:
    """Prints the outcome of a run for people."""
    observed = summary["observations"]
    rows: list[tuple[str, object]] = [
        ("result", summary["result"]),
        ("why", summary["reason"]),
        ("observed", observed if len(observed) <= 60 else f"{observed[:57]}... ({len(observed)})"),
    ]
    if emulation is None:
        if summary["cells"]:
            rows.append(("may be in", ", ".join(map(str, summary["cells"][:20]))))
    else:
        truth = summary["emulated"]
        rows.append(("started at", configuration(emulation.cells, truth["start"])))
        end = truth["end"]
        rows.append(("is at", "no cell" if end is None else configuration(emulation.cells, end)))
        if summary["cells"]:
            may = [configuration(emulation.cells, z) for z in summary["cells"][:8]]
            rows.append(("may be at", "\n".join(may)))
            rows.append(
                ("the truth is among them", "yes" if truth["truth_is_a_candidate"] else "NO")
            )
    table(title, ("", ""), rows)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotReplay:
    """Give the filter or plan of a logged run what the robot sensed, and compare."""

    log: tyro.conf.Positional[Path]
    """The run.jsonl of `jaxcell robot run --out`."""
    filter: Path | None = None
    """The filter that was run, if it is no more where it was."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        from ..automata import Filter
        from ..robot.run_log import read_log
        from ..robot.runner import plan_outcome, replay
        from ..robot.tasks import digest

        run = read_log(self.log)
        try:
            if run.header["kind"] == "plan":
                outcome = plan_outcome(run.header["actions"], run.observations)
            else:
                path = Path(run.header["file"]) if self.filter is None else self.filter
                if digest(path) != run.header["sha256"]:
                    raise ValueError(f"it is of another filter than {path} is now")
                outcome = replay(run, Filter.load(path))
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotCheck:
    """Ask a robot how it is."""

    port: str
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    firmware: bool = False
    """Also reboot it to read its firmware version, which takes ten seconds."""
    move: bool = False
    """Also drive 10 cm forward and back."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        from ..robot import Create, RobotStopped

        found: dict[str, Any] = {"port": self.port}
        if self.firmware:
            found["firmware"] = self._firmware()
        try:
            with Create.open(self.port) as robot:
                now = robot.sensors()
                found |= {
                    "mode": now.mode.name.lower(),
                    "battery_percent": round(100 * now.battery, 1),
                    "voltage_V": now.voltage,
                    "charging_state": now.charging_state,
                    "charger": now.charger,
                    "contact": [flag.name.lower() for flag in now.contact if flag.name],
                    "cliff": list(now.cliff),
                    "encoders": list(now.encoders),
                    "danger": now.danger,
                }
                if self.move:
                    robot.arm()
                    for name, way in [("forward_m", 0.1), ("back_m", -0.1)]:
                        moved = robot.forward(way)
                        found[name] = round(moved.distance, 4)
                        found["bumped"] = moved.bumped
        except RobotStopped as error:
            found["danger"] = str(error)
        if self.json:
            print(json.dumps(found))
        else:
            table(f"The robot at {self.port}", ("", ""), [(k, str(v)) for k, v in found.items()])
        return 0 if found["danger"] is None else 1

    def _firmware(self) -> str:
        import serial

        from ..robot.firmware import firmware
        from ..robot.open_interface import BAUD

        with (
            contextlib.closing(serial.serial_for_url(self.port, BAUD, exclusive=True)) as line,
            status("waiting for the robot to reboot"),
        ):
            return firmware(line)
