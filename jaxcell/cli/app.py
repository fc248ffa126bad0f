import dataclasses
import functools
import operator
import os
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from .demo import Demo
from .export import Export
from .info import Info
from .options import check_out
from .robot.calibrate import RobotCalibrate
from .robot.check import RobotCheck
from .robot.replay import RobotReplay
from .robot.run import RobotRun
from .robot.sketch import RobotSketch
from .run import Run
from .studies import (
    Cover,
    Drift,
    Dynamics,
    Groups,
    Localize,
    Navigate,
    PatrolGraph,
    PatrolMap,
    Team,
)
from .sweep.run import Sweep, SweepState
from .sweep.verify import SweepVerify
from .sweep.view import SweepView
from .view import View


_COMMANDS = {
    "cover": Cover,
    "demo": Demo,
    "drift": Drift,
    "dynamics": Dynamics,
    "export": Export,
    "groups": Groups,
    "info": Info,
    "localize": Localize,
    "navigate": Navigate,
    "patrol graph": PatrolGraph,
    "patrol map": PatrolMap,
    "robot calibrate": RobotCalibrate,
    "robot check": RobotCheck,
    "robot replay": RobotReplay,
    "robot run": RobotRun,
    "robot sketch": RobotSketch,
    "run": Run,
    "sweep": Sweep,
    "sweep status": SweepState,
    "sweep verify": SweepVerify,
    "sweep view": SweepView,
    "team": Team,
    "view": View,
}

_DESCRIPTION = """The global behaviour of simple robots, by cell-to-cell mapping.

Exit status: 0 done, 1 the task has no answer or --verify found a difference, 2 bad input."""


def _line(error: ValueError | OSError | MemoryError) -> str:
    """What an error says, as one line, which scripts read, without numbers of the system."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror}"
    return " ".join(re.sub(r"\[Errno -?\d+\] ", "", text).split())


def run(args: Sequence[str]) -> int:
    if list(args) == ["--version"]:
        from .. import __version__

        print(f"jaxcell {__version__}")
        return 0
    try:
        name, command = _read(list(args))
    except ValueError as error:
        print(f"jaxcell run: {error}", file=sys.stderr)
        return 2
    try:
        if (out := getattr(command, "out", None)) is not None:
            check_out(out, folder=not isinstance(command, RobotSketch | SweepView))
        return int(command.run())
    except BrokenPipeError:
        # Whoever read the output has seen enough, as `head` does; nothing is lost.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError, MemoryError) as error:
        print(f"jaxcell {name}: {_as_options(_line(error), type(command))}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        text = str(error)
        if text.startswith("No module named"):
            text += "; this command needs all of jaxcell: pip install jaxcell"
        print(f"jaxcell {name}: {text}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _read(args: list[str]) -> tuple[str, Any]:
    """The name of a command, and the command with its options."""
    if args[:1] == ["run"] and len(args) > 1 and not args[1].startswith("-"):
        from ..study.loading import load_study
        from .study import command as command_of

        name = f"run {args[1]}"
        kind = command_of(load_study(args[1]), name)
        config = (tyro.conf.FlagCreatePairsOff,)
        return name, tyro.cli(kind, args=args[2:], prog=f"jaxcell {name}", config=config)
    # Some names are of two words, of which the first is that of a group.
    words = " ".join(args[:2])
    if words in _COMMANDS:
        args = [words, *args[2:]]
    choices: Any = functools.reduce(
        operator.or_,
        (
            Annotated[command, tyro.conf.subcommand(name, prefix_name=False)]
            for name, command in _COMMANDS.items()
        ),
    )
    command = tyro.cli(
        choices,
        args=args,
        prog="jaxcell",
        description=_DESCRIPTION,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    return next(name for name, kind in _COMMANDS.items() if type(command) is kind), command


def _as_options(message: str, command: Any) -> str:
    """A message that begins with the name of a parameter, with that of its option."""
    name = re.split("[: ]", message, maxsplit=1)[0]
    if not any(field.name == name for field in dataclasses.fields(command)):
        return message
    return f"--{name.replace('_', '-')}{message[len(name) :]}"
