import dataclasses
import errno
import math
import os
import re
import sys
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from ..base.bundled import bundled_names
from ..base.memory import LIMIT, check_addresses, read_size
from ..base.paths import absent
from .completion import OPTION as COMPLETION, print_completion
from .demo import Demo
from .docs import Docs
from .doctor import Doctor
from .encoding import allow_any_encoding
from .export import Export
from .help import as_options, option, overview, unknown
from .maps import Maps
from .output import check_out
from .robot.calibrate import RobotCalibrate
from .robot.check import RobotCheck
from .robot.replay import RobotReplay
from .robot.run import RobotRun
from .robot.sketch import RobotSketch
from .study_command import STUDY_COMMANDS, Run, StudyCommand, read_study
from .sweep.indices import SweepIndices
from .sweep.run import Sweep, SweepMerge, SweepState
from .sweep.view import SweepView
from .terminal import noting_warnings
from .verify import Verify
from .view import View
from .words import parsed
from .wrong_file import described_instead


# The class of each command, by the words after `jaxcell`, in the order of `jaxcell --help`.
COMMANDS: dict[str, Any] = dict(
    sorted(
        {
            **STUDY_COMMANDS,
            "demo": Demo,
            "docs": Docs,
            "doctor": Doctor,
            "export": Export,
            "maps": Maps,
            "robot calibrate": RobotCalibrate,
            "robot check": RobotCheck,
            "robot replay": RobotReplay,
            "robot run": RobotRun,
            "robot sketch": RobotSketch,
            "run": Run,
            "sweep": Sweep,
            "sweep indices": SweepIndices,
            "sweep merge": SweepMerge,
            "sweep status": SweepState,
            "sweep view": SweepView,
            "verify": Verify,
            "view": View,
        }.items()
    )
)

# Largest number of directions that an error recommends.
_MAX_DIRECTIONS = 3600
# Errors of disks, which may not name the folder.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# The words of the system if too few addresses are left for a library.
_UNMAPPED = "failed to map segment"
# Letters of an error, which may quote a damaged file.
_MAX_LETTERS = 2000


def _line(error: ValueError | OSError | MemoryError) -> str:
    """Format an error as one line of bounded length, without the system's number of the error."""
    text = str(error)
    if isinstance(error, MemoryError) and (not text or type(error) is not MemoryError):
        # Python says nothing, and NumPy no remedy.
        which = f" ({text})" if text else ""
        text = (
            f"the memory is too little{which}; fewer or larger cells, or fewer members, need less"
        )
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        missing = isinstance(error, FileNotFoundError)
        text = str(absent(error.filename)) if missing else f"{error.filename}: {error.strerror}"
    text = " ".join(re.sub(r"\[Errno -?\d+\] ", "", text).split())
    text = "".join(letter if letter.isprintable() else "\ufffd" for letter in text)
    return text if len(text) <= _MAX_LETTERS else f"{text[:_MAX_LETTERS]} ..."


def run(args: Sequence[str]) -> int:
    allow_any_encoding()
    if list(args) in (["--version"], ["-V"]):
        from .. import __version__

        print(f"jaxcell {__version__}")
        return 0
    name = ""
    try:
        args = _limited(args)
        name, command = read(args)
        check_addresses(
            "JAX"
            if isinstance(command, StudyCommand | Demo)
            else "xarray"
            if isinstance(command, Sweep | SweepMerge | SweepIndices)
            else "NumPy"
        )
        if (out := getattr(command, "out", None)) is not None:
            check_out(out, folder=not isinstance(command, RobotSketch | SweepView | Doctor))
        with noting_warnings(type(command)):
            return int(command.run())
    except BrokenPipeError:
        # The reader of the output, such as `head`, needs no more of it. This is not an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError, MemoryError) as error:
        line = _line(error)
        if name:
            line = described_instead(name, command, line, COMMANDS)
            line = _with_option_names(line, command)
        out = getattr(command, "out", getattr(command, "file", None)) if name else None
        if isinstance(error, OSError) and error.errno in _DISK and out and str(out) not in line:
            line = f"{out}: {line}"
        for bundle, path in bundled_names().items():
            line = line.replace(str(path), f"@{bundle}")
        print(f"jaxcell {name or _name(args) or args[0]}: {line}", file=sys.stderr)
        return 2
    except ImportError as error:
        text = str(error)
        if text.startswith("No module named"):
            text += "; this command needs all of jaxcell: pip install 'jaxcell[app]'"
        elif _UNMAPPED in text:
            text += "; the memory is too little to load it"
        print(f"jaxcell {name or _name(args) or args[0]}: {text}", file=sys.stderr)
        return 2


def _limited(args: Sequence[str]) -> list[str]:
    """Set the memory limit to the value of --memory, if it is given; return the other words."""
    words = list(args)
    for place, word in enumerate(words):
        option, equals, size = word.partition("=")
        if option == "--memory":
            if not equals:
                size = "".join(words[place + 1 : place + 2])
            read_size(size, option)
            os.environ[LIMIT] = size
            return words[:place] + words[place + (1 if equals else 2) :]
    return words


def read(args: Sequence[str]) -> tuple[str, Any]:
    """Parse the words of a command line, and return the name of the command and its options."""
    words = list(args)
    while words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    if (command := read_study(words)) is not None:
        return command
    if not (name := _name(words)):
        group = {each: kind for each, kind in COMMANDS.items() if each.split()[0] in words[:1]}
        if words[:1] == [COMPLETION]:
            print_completion(COMMANDS, words)
        elif not words or words[0] in ("-h", "--help"):
            overview(COMMANDS)
        elif group and words[1:2] in (["-h"], ["--help"]):
            overview(group, words[0])
        elif group and not words[1:]:
            overview(group, words[0], status=2)
        else:
            unknown(words, COMMANDS)
    return name, parsed(COMMANDS[name], name, words[len(name.split()) :], COMMANDS)


def _name(words: Sequence[str]) -> str:
    return next((name for name in (" ".join(words[:2]), *words[:1]) if name in COMMANDS), "")


def _with_option_names(message: str, command: Any) -> str:
    """Replace names of parameters, first in a message or in backquotes, with names of options."""
    kind = type(command)
    message = as_options(kind, message)
    name = re.split("[: ]", message, maxsplit=1)[0]
    if not any(field.name == name for field in dataclasses.fields(command)):
        return message
    line = f"{option(kind, name)}{message[len(name) :]}"
    if "is not a whole number of the" in message and (wanted := _directions(command)):
        line += f"; --directions {wanted} would do"
    return line


def _directions(command: Any) -> int | None:
    """Count the equally spaced directions that the angles of a command need; `None` if too many."""
    values = [getattr(command, name, None) for name in ("bounce", "error")]
    angles = [
        angle
        for value in values
        for angle in (value if isinstance(value, tuple) else [value])
        if angle is not None
    ]
    if not hasattr(command, "directions") or not all(map(math.isfinite, angles)):
        return None
    wanted = math.lcm(*((Fraction(str(angle)) / 360).denominator for angle in angles))
    return wanted if wanted <= _MAX_DIRECTIONS else None
