import dataclasses
import json
import os
import reprlib
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..base.documents import check_version
from ..base.shown import Shown
from .create.driver import RobotStopped
from .outcome import RunOutcome
from .walker import Walker


_O = TypeVar("_O", bound=RunOutcome)

_FORMAT = "jaxcell-robot-log"
_VERSION = 1


class RunLog:
    """The log of a run: one JSON object per line, each flushed before the robot continues.

    The first line describes the run. Every other line is an event, with the seconds since the
    beginning of the log. A log is a context manager; [`read_log`][] has an example.
    """

    on_event: Callable[[str, Mapping[str, Any]], None] | None
    "A function that is called with the name and the fields of each event, or `None`."

    def __init__(self, path: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        """Create the file. The header is a JSON object that describes the run.

        **Raises:** `FileExistsError` if the file exists, because a log is never overwritten.
        """
        self.on_event = None
        self._began = time.monotonic()
        line = _line({"format": _FORMAT, "version": _VERSION, **header})
        self._file = open(path, "x", encoding="utf-8")  # noqa: SIM115
        self._write(line)

    def event(self, name: str, **fields: Any) -> None:
        """Write an event."""
        seconds = round(time.monotonic() - self._began, 3)
        self._write(_line({"event": name, "seconds": seconds, **fields}))
        if self.on_event is not None:
            self.on_event(name, {"seconds": seconds, **fields})

    def observation(self, walker: Walker, **fields: Any) -> None:
        """Write the latest observation of a robot, and the estimate of its pose."""
        if len(walker.observations) <= len(walker.recalled):
            fields["recalled"] = True
        self.event(
            "observation",
            observation=int(walker.observations[-1]),
            **fields,
            # The sum removes the sign of a zero.
            estimate=(np.round(walker.estimate, 4) + 0.0).tolist(),
        )

    def _write(self, line: str) -> None:
        self._file.write(line)
        self._file.flush()

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        with self._file:
            if error is not None:
                self.event("stopped", reason=why_stopped(error))


def _line(values: Mapping[str, Any]) -> str:
    return json.dumps(values, allow_nan=False) + "\n"


@dataclasses.dataclass(frozen=True)
class LoggedRun(Shown):
    """The log of a run, as read from its file."""

    header: Mapping[str, Any]
    "The description of the run, from the first line of the file."
    events: tuple[Mapping[str, Any], ...]
    "The events in order, from the other lines of the file."
    whole: bool
    "False if the last line is incomplete, for example after a power failure."

    @property
    def observations(self) -> str:
        """The observations of the robot: 0 for a step, 1 for a bump."""
        return "".join(str(event["observation"]) for event in self._observed())

    @property
    def direction(self) -> int | None:
        """The number of the robot's direction at the start, or `None` if it is unknown."""
        direction = self.header.get("direction")
        if direction is not None and (type(direction) is not int or direction < 0):
            raise ValueError(f"direction: expected a whole number or null, got {direction!r}")
        return direction

    @property
    def colors(self) -> list[int]:
        """The output (colour) of a filter or policy after each observation; otherwise empty."""
        return [event["color"] for event in self._observed() if "color" in event]

    @property
    def stopped(self) -> str | None:
        """The reason why the run was stopped before its end, or `None`."""
        last = self.events[-1] if self.events else {}
        return str(last.get("reason", "")) if last.get("event") == "stopped" else None

    def _observed(self) -> Iterator[Mapping[str, Any]]:
        return (event for event in self.events if event["event"] == "observation")


def why_stopped(error: BaseException) -> str:
    """Describe the error that stopped a run."""
    match error:
        case RobotStopped():
            return f"the robot was stopped: {error}"
        case KeyboardInterrupt():
            return "Ctrl-C"
        case SystemExit():
            return "a signal ended the program"
    return f"{type(error).__name__}: {error}"


def stopped(outcome: _O, run: LoggedRun) -> _O:
    """Mark the unfinished replay of a stopped run as stopped, and add the reason."""
    if run.stopped is None or outcome.result != "unfinished":
        return outcome
    return dataclasses.replace(outcome, result="stopped", reason=f"{run.stopped}; {outcome.reason}")


def finished(outcome: _O, log: RunLog | None) -> _O:
    """Write the outcome of a run to its log, and return the outcome."""
    if log is not None:
        log.event("end", result=outcome.result, reason=outcome.reason)
    return outcome


def read_log(path: str | os.PathLike[str]) -> LoggedRun:
    """Read the log of a run, even if the file was cut off.

    **Arguments:** the path of the file. **Returns:** the run so far.

    **Raises:** `ValueError`, with the file and the line, if the file is not the log of a run;
    `FileNotFoundError` if there is no file.

    A log with one event, whose file is cut off:

        >>> from jaxcell import examples, robot
        >>> path = examples.folder() / "run.jsonl"
        >>> with robot.RunLog(path, {"kind": "trial"}) as log:
        ...     log.event("note", text="off we go")
        >>> _ = path.write_bytes(path.read_bytes()[:-3])
        >>> robot.read_log(path).whole
        False
    """
    text = Path(path).read_bytes()
    lines = text.split(b"\n")
    # The text after the last newline is an incomplete line.
    unfinished = lines.pop()
    parsed = []
    for number, line in enumerate(lines, 1):
        try:
            parsed.append(json.loads(line))
            if not isinstance(parsed[-1], dict):
                raise ValueError("expected a JSON object")
            if number > 1:
                _check_event(parsed[-1])
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path}: line {number}: {error}") from None
    header = parsed[0] if parsed else {}
    if header.get("format") != _FORMAT:
        raise ValueError(
            f"{path}: line 1: expected the log of a robot, format {_FORMAT!r}, got "
            f"{reprlib.repr(header.get('format'))}"
        )
    check_version(header.get("version"), _VERSION, f"{path}: line 1: ")
    return LoggedRun(header, tuple(parsed[1:]), not unfinished)


def _check_event(event: Mapping[str, Any]) -> None:
    name = event.get("event")
    if not isinstance(name, str):
        raise ValueError(f"event: expected a name, got {reprlib.repr(name)}")
    observation = event.get("observation")
    # A test by `in (0, 1)` would accept the JSON values true and 1.0, which equal 1.
    if name == "observation" and (type(observation) is not int or not 0 <= observation <= 1):
        raise ValueError(f"observation: expected 0 or 1, got {reprlib.repr(observation)}")
    if type(event.get("color", 0)) is not int:
        raise ValueError(f"color: expected a whole number, got {reprlib.repr(event['color'])}")
