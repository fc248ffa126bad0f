"""Help pages: those of tyro, plus an example, and the units and conditions of options."""

import ast
import difflib
import functools
import inspect
import itertools
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields
from typing import Annotated, Any, NoReturn, get_args, get_origin

import tyro
from rich.console import Console
from rich.table import Table

from ..study.parameters import Needed, Only, Unit, conditions, inside, listed, parameters, within


_ABOUT = """Compute the global behaviour of simple robots by cell-to-cell mapping. A map, a graph or
currents are a file, or a name such as @lab_a, which `jaxcell maps` lists. Numbers may have units:
45deg, 50cm, 2h, 2%. The option --memory 8G of any command refuses work that needs more memory in
one process, by an estimate before it starts; work that needs less than 20 MB is never refused.

Exit status: 0 done, 1 the task has no answer or --verify found a difference, 2 bad input."""
_UNITS = {"d": "DAYS", "deg": "DEG", "m": "M", "s": "S"}
# Default values that a page of help does not show.
_EMPTY = {"None", "", "False"}
# Options of many commands, which a page of help lists last.
_LAST = {"out", "json", "verify"}


def example(kind: Any, name: str) -> str:
    return f"jaxcell {name} {kind.example}".rstrip()


def page(kind: Any, name: str) -> NoReturn:
    """Print the page of help of the command `name` with the class `kind`, and exit."""
    about = [inspect.cleandoc(kind.__doc__ or "")]
    if one_of := getattr(kind, "one_of", ()):
        about.append(f"Needs {listed(tuple(option(kind, name) for name in one_of))}.")
    about += [f"Example: {example(kind, name)}"] if hasattr(kind, "example") else []
    tyro.cli(
        displayed(kind),
        args=["--help"],
        prog=f"jaxcell {name}",
        description="\n\n".join(about),
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
    )
    raise AssertionError("tyro exits after the page")


def option(kind: type, parameter: str) -> str:
    """Return the name of a parameter on the command line."""
    positional = is_positional(parameters(kind)[parameter])
    return parameter.upper() if positional else f"--{parameter.replace('_', '-')}"


def as_options(kind: type, text: str) -> str:
    """Replace parameters in backquotes, and those with a value, with their options.

    For example, "`follow`" becomes "--follow", and "follow=4" becomes "--follow 4".
    """
    known = parameters(kind)

    def typed(found: re.Match[str]) -> str:
        name, value = found[1] or found[3], found[2]
        if name not in known:
            return found[0]
        return " ".join([option(kind, name), *filter(None, [value])]) + " " * bool(found[3])

    return re.sub(r"`(\w+)(?:=\"(\w+)\")?`|\b(?<!-)(\w+)=(?=\w)", typed, text)


def overview(commands: Mapping[str, type], group: str = "") -> NoReturn:
    """Print a list of commands, and exit."""
    print(f"usage: jaxcell {group} COMMAND ...".replace("  ", " "))
    if not group:
        print(f"\n{_ABOUT}")
    table = Table(box=None, show_header=False, padding=(0, 2), pad_edge=True)
    for name, kind in commands.items():
        sentence = re.split(r"(?<=[a-z)])[.;] ", " ".join((kind.__doc__ or "").split()))[0]
        table.add_row(name, sentence.rstrip("."))
    Console(highlight=False).print(
        "\nCommands; `jaxcell help COMMAND` describes one:\n", table, sep="\n"
    )
    sys.exit(0)


def unknown(words: Sequence[str], commands: Mapping[str, type]) -> NoReturn:
    """Report an unknown command with the most similar known command, and exit."""
    groups = {name.split()[0] for name in commands if " " in name}
    wanted = " ".join(words[:2]) if words[0] in groups else words[0]
    similar = difflib.get_close_matches(wanted, [*commands, *groups], 1, 0.5)
    if wanted in groups:
        advice = (
            f"expected one of {', '.join(name for name in commands if name.startswith(wanted))}"
        )
    else:
        advice = f"did you mean {similar[0]}?" if similar else "jaxcell --help lists them"
    print(f"jaxcell: there is no command {wanted}; {advice}", file=sys.stderr)
    sys.exit(2)


# Cached, because reading the source takes half of the time of a page.
@functools.cache
def displayed(kind: type) -> type:
    """Create a class that has the options of a command in the order of its help page.

    Required options come first, then options of this command, then those that many commands share.
    """
    hints, texts, noted = parameters(kind), _documentation(kind), conditions(kind)
    level = {
        name: number
        for number, base in reversed(list(enumerate(kind.__mro__)))
        for name in inspect.get_annotations(base)
    }

    def place(field: "Field[Any]") -> tuple[bool, bool, int]:
        optional = field.default is not MISSING or field.default_factory is not MISSING
        return optional, field.name in _LAST, level[field.name]

    ordered = sorted(fields(kind), key=place)
    annotations = {
        field.name: Annotated[
            hints[field.name],
            tyro.conf.arg(
                help=" ".join(
                    filter(None, (texts.get(field.name), _when(kind, noted.get(field.name, []))))
                ),
                metavar=_metavar(field.name, hints[field.name]),
                help_behavior_hint=lambda text: "" if text in _EMPTY else f"(default: {text})",
            ),
        ]
        for field in ordered
    }
    shown = type(kind.__name__, (kind,), {"__doc__": kind.__doc__, "__annotations__": annotations})
    shown.__dataclass_fields__ = {field.name: field for field in ordered}  # type: ignore[attr-defined]
    return shown


def _documentation(kind: type) -> dict[str, str]:
    """Read the docstring below each field in the source, without line breaks."""
    texts = {}
    for base in reversed(kind.__mro__):
        try:
            source = textwrap.dedent(inspect.getsource(base))
        except (OSError, TypeError):
            # The source of the class is not in a file.
            continue
        for field, text in itertools.pairwise(ast.parse(source).body[0].body):  # type: ignore[attr-defined]
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(words))),
                ):
                    texts[name] = " ".join(words.split())
    return texts


def _when(kind: type, alternatives: Sequence[Only]) -> str:
    """Format the conditions of an option as a sentence."""
    begin = "Needed" if any(isinstance(each, Needed) for each in alternatives) else "Only"
    listed = as_options(kind, ", or ".join(map(str, alternatives)))
    return f"{begin} {listed}." if listed else ""


def _metavar(name: str, hint: Any) -> str | None:
    """Return the placeholder of a value in the help: its unit, or `None` for tyro's default."""
    if is_positional(hint):
        return name.upper()
    several: list[tuple[Any, ...]]
    several = [get_args(part) for part in inside(hint) if get_origin(part) is tuple]
    if several and Ellipsis not in several[0]:
        return " ".join(kind.__name__.upper() for kind in several[0])
    if (unit := within(hint, Unit)) is None:
        return None
    word = _UNITS[unit.suffix]
    return f"{word} [{word} ...]" if several else word


def is_positional(hint: Any) -> bool:
    """Return whether a parameter is written without the name of an option."""
    return get_args(tyro.conf.Positional[int])[1] in getattr(hint, "__metadata__", ())
