import functools
import operator
import os
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from .cover import Cover
from .demo import Demo
from .drift import Drift
from .export import Export
from .groups import Groups
from .info import Info
from .localize import Localize
from .navigate import Navigate
from .options import check_out
from .patrol_graph import PatrolGraph
from .patrol_map import PatrolMap
from .robot import RobotRun
from .robot_check import RobotCheck
from .robot_replay import RobotReplay
from .robot_sketch import RobotSketch
from .sweep import Sweep, SweepState
from .sweep_verify import SweepVerify
from .sweep_view import SweepView
from .team import Team
from .view import View


_COMMANDS = {
    "cover": Cover,
    "demo": Demo,
    "drift": Drift,
    "export": Export,
    "groups": Groups,
    "info": Info,
    "localize": Localize,
    "navigate": Navigate,
    "patrol graph": PatrolGraph,
    "patrol map": PatrolMap,
    "robot check": RobotCheck,
    "robot replay": RobotReplay,
    "robot run": RobotRun,
    "robot sketch": RobotSketch,
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
        args=list(args),
        prog="jaxcell",
        description=_DESCRIPTION,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        if (out := getattr(command, "out", None)) is not None:
            check_out(out, folder=not isinstance(command, RobotSketch | SweepView))
        return command.run()
    except BrokenPipeError:
        # Whoever read the output has seen enough, as `head` does; nothing is lost.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError, MemoryError) as error:
        name = next(name for name, kind in _COMMANDS.items() if type(command) is kind)
        print(f"jaxcell {name}: {_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
