"""Help: what a command needs comes first, in its usage and on its page, and there is an example."""

import ast
import contextlib
import dataclasses
import difflib
import functools
import inspect
import io
import itertools
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import tyro
from rich.console import Console
from rich.table import Table

from ..study.study import unit


_EXAMPLES = {
    "cover": "@complex --bounces 30 75 315 --error 5 --reliability 0.8",
    "demo": "",
    "docs": "",
    "drift": "@gyres --depths 0 --out runs/drift",
    "drifters": "@drifters --nearly-closed 2 --out runs/drifters",
    "dynamics": "pendulum --params T=0.1:0.9:17",
    "export": "runs/lab/filter.jxf filter.h",
    "groups": "@lab_a --bounce 45 90 135",
    "info": "@lab_a",
    "localize": "@lab_a --bounce 135 --out runs/lab",
    "maps": "",
    "navigate": "@complex --bounces 45 90 135 --start 0.5,1.5,0 --goal 12.5,9.5,0",
    "patrol graph": "@random --robots 2",
    "patrol map": "@depot --robots 2 --range 6",
    "robot calibrate": "--port /dev/ttyUSB0",
    "robot check": "--port /dev/ttyUSB0",
    "robot replay": "runs/emulated/run.jsonl",
    "robot run": "runs/lab/filter.jxf --simulate @lab_a --heading 0 --out runs/emulated",
    "robot sketch": "runs/lab/filter.jxf --heading 0 --out localize.ino",
    "run": "my_study.py:MyStudy --help",
    "sweep": "@rooms --engine processes --out runs/rooms",
    "sweep indices": "runs/samples",
    "sweep merge": "runs/rooms",
    "sweep status": "runs/rooms",
    "sweep verify": "runs/rooms",
    "sweep view": "runs/rooms",
    "team": "@complex --robots 4 --bounces 135",
    "view": "runs/lab",
}
# By commands, the options and files of which one is needed.
_ONE_OF = {
    "localize": ("bounce", "bounces"),
    "robot run": ("port", "ros", "simulate"),
    "robot sketch": ("file", "bounce"),
}
_ABOUT = """The global behaviour of simple robots, by cell-to-cell mapping. A map, a graph
or currents are a file, or a name such as @lab_a, which `jaxcell maps` lists.
With --memory 8G a command refuses what would take more than that in a process.

Exit status: 0 done, 1 the task has no answer or --verify found a difference, 2 bad input."""
_UNITS = {"d": "DAYS", "deg": "DEG", "m": "M", "s": "S"}
_NOTHING = {"None", "", "False"}


class _Page(io.StringIO):
    """Text that is kept, in the colours and characters of where it is to be shown."""

    def __init__(self, shown: Any) -> None:
        super().__init__()
        self.shown = shown

    def isatty(self) -> bool:
        return bool(self.shown.isatty())

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self.shown.encoding or "ascii"


def example(name: str) -> str:
    """A command line that shows a command."""
    return f"jaxcell {name} {_EXAMPLES[name]}".rstrip()


def parsed(kind: type, name: str, words: Sequence[str]) -> Any:
    """A command with the options that it is given.

    **Raises:** `SystemExit` after a page of help, or of what is wrong with the options.
    """
    about = inspect.cleandoc(kind.__doc__ or "")
    if name in _EXAMPLES:
        about += f"\n\nExample: {example(name)}"
    shown = displayed(kind)
    _check_options(shown, name, words)
    page = _Page(sys.stdout)
    try:
        with contextlib.redirect_stdout(page):
            return tyro.cli(
                shown,
                args=list(words),
                prog=f"jaxcell {name}",
                description=about,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    finally:
        print(re.sub(r"\Ausage: .*", lambda _: _usage(shown, name), page.getvalue()), end="")


def _check_options(shown: type, name: str, words: Sequence[str]) -> None:
    """End with the most similar option if a command has no option of a name."""
    hints = get_type_hints(shown, include_extras=True)
    options = [_option(field.name, hints[field.name]) for field in dataclasses.fields(shown)]
    known = ["--help", *(one for one in options if one.startswith("--"))]
    for word in words:
        given = word.partition("=")[0].replace("_", "-")
        if word.startswith("--") and given not in known and not given.startswith("--tyro-"):
            near = difflib.get_close_matches(given, known, 1, 0.7)
            meant = f"did you mean {near[0]}?" if near else f"jaxcell {name} --help lists them"
            print(f"jaxcell {name}: there is no option {given}; {meant}", file=sys.stderr)
            sys.exit(2)


def option(kind: type, parameter: str) -> str:
    """What a parameter of a command is called in its usage."""
    return _option(parameter, get_type_hints(kind, include_extras=True)[parameter])


def _option(name: str, hint: Any) -> str:
    return name.upper() if _is_positional(hint) else f"--{name.replace('_', '-')}"


def overview(commands: Mapping[str, type], group: str = "") -> NoReturn:
    """Show a page of commands, and end."""
    console = Console(highlight=False)
    print(f"usage: jaxcell {group} COMMAND ...".replace("  ", " "))
    if not group:
        print(f"\n{_ABOUT}")
    table = Table(box=None, show_header=False, padding=(0, 2), pad_edge=True)
    for name, kind in commands.items():
        table.add_row(name, _first_sentence(kind))
    console.print("\nCommands; each takes --help:\n", table, sep="\n")
    sys.exit(0)


def unknown(words: Sequence[str], commands: Mapping[str, type]) -> NoReturn:
    """Say that there is no such command, and which is most like it, and end."""
    two = {name.split()[0] for name in commands if " " in name}
    said = " ".join(words[:2]) if words[0] in two else words[0]
    near = difflib.get_close_matches(said, [*commands, *two], 1, 0.5)
    if said in two:
        meant = f"expected one of {', '.join(one for one in commands if one.startswith(said))}"
    else:
        meant = f"did you mean {near[0]}?" if near else "jaxcell --help lists them"
    print(f"jaxcell: there is no command {said}; {meant}", file=sys.stderr)
    sys.exit(2)


def _first_sentence(kind: type) -> str:
    text = " ".join((kind.__doc__ or "").split())
    return re.split(r"(?<=[a-z)])[.;] ", text)[0].rstrip(".")


# To read a source takes as long as all else that is said of a command.
@functools.cache
def displayed(kind: type) -> type:
    """A class whose fields are in the order in which help shows them, and as it shows them.

    First is what is required, then what the command has of its own, then what it has in common with
    others, the results last.
    """
    hints = get_type_hints(kind, include_extras=True)
    depth = {
        field: level
        for level, base in reversed(list(enumerate(kind.__mro__)))
        for field in inspect.get_annotations(base)
    }
    last = {"out", "json", "verify"}
    fields = sorted(
        dataclasses.fields(kind),
        key=lambda field: (not _required(field), field.name in last, depth[field.name]),
    )
    said = _documentation(kind)
    annotations = {
        field.name: _described(field.name, hints[field.name], said.get(field.name))
        for field in fields
    }
    shown = type(kind.__name__, (kind,), {"__doc__": kind.__doc__, "__annotations__": annotations})
    shown.__dataclass_fields__ = {field.name: field for field in fields}  # type: ignore[attr-defined]
    return shown


def _required(field: "dataclasses.Field[Any]") -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _documentation(kind: type) -> dict[str, str]:
    """What is said below each field, in one line: lines of a source are no lines of help."""
    found = {}
    for base in reversed(kind.__mro__):
        try:
            source = inspect.getsource(base)
        except (OSError, TypeError):
            # Of a class that no file has.
            continue
        (parsed,) = ast.parse(textwrap.dedent(source)).body
        for field, text in itertools.pairwise(getattr(parsed, "body", [])):
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(said))),
                ):
                    found[name] = " ".join(said.split())
    return found


def _described(name: str, hint: Any, said: str | None) -> Any:
    """An annotation with the unit in place of its type, and without a default that says nothing."""
    options: dict[str, Any] = {
        "help": said,
        "help_behavior_hint": lambda label: "" if label in _NOTHING else f"(default: {label})",
    }
    if (metavar := _metavar(name, hint)) is not None:
        options["metavar"] = metavar
    given = (getattr(one, "name", None) for one in getattr(hint, "__metadata__", ()))
    return Annotated[hint, tyro.conf.arg(name=next(filter(None, given), None), **options)]


def _metavar(name: str, hint: Any) -> str | None:
    """What stands for the value of an option; `None` for what its type says."""
    if _is_positional(hint):
        return name.upper()
    if kinds := _fixed(hint):
        return " ".join(map(_kind, kinds))
    if unit(hint) not in _UNITS:
        return None
    one = _kind(hint)
    return f"{one} [{one} ...]" if _is_tuple(hint) else one


def _kind(hint: Any) -> str:
    """The unit of a value, or else its type."""
    if (one := _UNITS.get(unit(hint) or "")) is not None:
        return one
    first = next(part for part in _parts(hint) if isinstance(part, type) or _is_literal(part))
    return f"{{{','.join(first.__args__)}}}" if _is_literal(first) else first.__name__.upper()


def _fixed(hint: Any) -> tuple[Any, ...]:
    """The types of the values of a tuple of so many; nothing for other types."""
    kinds = next((one.__args__ for one in _parts(hint) if get_origin(one) is tuple), ())
    return () if Ellipsis in kinds else kinds


def _parts(hint: Any) -> Iterator[Any]:
    """A type and the types that it is made of."""
    yield hint
    for one in getattr(hint, "__args__", ()):
        yield from _parts(one)


def _is_literal(hint: Any) -> bool:
    return get_origin(hint) is Literal


def _is_positional(hint: Any) -> bool:
    return get_args(tyro.conf.Positional[int])[1] in getattr(hint, "__metadata__", ())


def _is_tuple(hint: Any) -> bool:
    return any(get_origin(one) is tuple for one in _parts(hint))


def _usage(shown: type, name: str) -> str:
    """The usage of a command: what is required, by name."""
    hints = get_type_hints(shown, include_extras=True)
    words: list[str] = []
    options: list[str] = []
    for field in filter(_required, dataclasses.fields(shown)):
        hint = hints[field.name]
        (words if _is_positional(hint) else options).append(_named(field.name, hint))
    if name in _ONE_OF:
        options.append(f"({' | '.join(_named(one, hints[one]) for one in _ONE_OF[name])})")
    return " ".join(["usage: jaxcell", name, *words, *options, "[OPTIONS]"])


def _named(name: str, hint: Any) -> str:
    """An option or a file as the usage of a command has it."""
    said = _option(name, hint)
    if not _is_positional(hint):
        return f"{said} {_metavar(name, hint) or _kind(hint)}"
    return f"{said} [{said} ...]" if _is_tuple(hint) else said
