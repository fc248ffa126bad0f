"""Help pages: those of tyro, plus an example, and the units and conditions of options."""

import ast
import contextlib
import difflib
import functools
import inspect
import io
import itertools
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, field, fields, make_dataclass
from typing import Annotated, Any, NoReturn, get_args, get_origin

import tyro
from rich.console import Console
from rich.table import Table

from ..study.parameters import (
    Needed,
    Only,
    Unit,
    choices_and_types,
    conditions,
    inside,
    listed,
    parameters,
    within,
)


_ABOUT = """Compute the global behaviour of simple robots by cell-to-cell mapping. A map, a graph or
currents are a file, or a name such as @lab_a, which `jaxcell maps` lists. Numbers may have units:
45deg, 50cm, 2h, 2%. The option --memory 8G of any command refuses work that needs more memory in
one process, by an estimate before it starts; work that needs less than 20 MB is never refused.

Exit status: 0 done, 1 the task has no answer or --verify found a difference, 2 bad input."""
# Default values that a page of help does not show.
_EMPTY = {"None", "", "False"}
# Options of many commands, which a page of help lists last.
_LAST = {"out", "json", "verify"}


def example(kind: Any, name: str) -> str:
    return f"jaxcell {name} {kind.example}".rstrip()


def page(kind: Any, name: str) -> NoReturn:
    """Print the page of help of the command `name` with the class `kind`, and exit."""
    about = inspect.cleandoc(kind.__doc__ or "").split("\n\n")
    if one_of := getattr(kind, "one_of", ()):
        about.append(f"Needs {listed(tuple(option(kind, name) for name in one_of))}.")
    about += [f"Example: {example(kind, name)}"] if hasattr(kind, "example") else []
    printed = io.TextIOWrapper(io.BytesIO(), sys.stdout.encoding)
    printed.isatty = sys.stdout.isatty  # type: ignore[method-assign]
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(printed):
        tyro.cli(
            displayed(kind),
            args=["--help"],
            prog=f"jaxcell {name}",
            description="",
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
    printed.seek(0)
    usage, _, options = printed.read().partition("\n\n")
    # tyro adds a word to each heading.
    line = "─" if "─" in options else " "
    options = re.sub(r"\?(\S*) options(\S*) ", rf"?\1\2 {line * 8}", options).rstrip("\n")
    # tyro adds a space for a default to each text; if the text fills a row, it begins another.
    options = re.sub(r"^(?:\x1b\[[\d;]*m| )*│(?:\x1b\[[\d;]*m| )*│.*\n", "", options, flags=re.M)
    print(*map(_filled, (usage, *about)), options, sep="\n\n")
    sys.exit(0)


def _filled(text: str) -> str:
    """Break a paragraph into lines that are as long as the screen, and an example as a shell does.

    Words stay whole.
    """
    width, end = shutil.get_terminal_size().columns, " \\" if text.startswith("Example") else ""
    lines = textwrap.wrap(text, width - len(end), break_long_words=False, break_on_hyphens=False)
    return f"{end}\n{'  ' if end else ''}".join(lines)


def option(kind: type, parameter: str) -> str:
    """Return the name of a parameter on the command line: that of `from_` is `--from`."""
    positional = is_positional(parameters(kind)[parameter])
    name = parameter.rstrip("_").replace("_", "-")
    return parameter.upper() if positional else f"--{name}"


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


def overview(commands: Mapping[str, type], group: str = "", status: int = 0) -> NoReturn:
    """Print a list of commands, and exit with `status`; a `status` of 2 is an error."""
    console = Console(highlight=False, stderr=status == 2)
    print(f"usage: jaxcell {group} COMMAND ...".replace("  ", " "), file=console.file)
    if not group:
        print(*(f"\n{_filled(part)}" for part in _ABOUT.split("\n\n")), sep="\n")
    table = Table(box=None, show_header=False, padding=(0, 2), pad_edge=True)
    for name, kind in commands.items():
        sentence = re.split(r"(?<=[a-z)])[.;] ", " ".join((kind.__doc__ or "").split()))[0]
        table.add_row(name, sentence.rstrip("."))
    console.print("\nCommands; `jaxcell help COMMAND` describes one:\n", table, sep="\n")
    sys.exit(status)


def unknown(words: Sequence[str], commands: Mapping[str, type]) -> NoReturn:
    """Report an unknown command with the most similar known command, and exit."""
    groups = {name.split()[0] for name in commands if " " in name}
    group = words[0] if words[0] in groups else ""
    wanted = " ".join(words[:2]) if group else words[0]
    similar = difflib.get_close_matches(wanted, [*commands, *(groups - {group})], 1, 0.5)
    lists = " ".join(filter(None, ("jaxcell", group, "--help lists them")))
    advice = f"did you mean {similar[0]}?" if similar else lists
    print(f"jaxcell: there is no command {wanted}; {advice}", file=sys.stderr)
    sys.exit(2)


# Cached, because reading the source takes half of the time of a page.
@functools.cache
def displayed(kind: type) -> type:
    """Create a class that has the options of a command in the order of its help page.

    Required options come first, then options of this command, then those that many commands share.
    The options of a heading are the fields of a class of their own.
    """
    hints, texts, noted = parameters(kind), _documentation(kind), conditions(kind)
    level = {
        name: number
        for number, base in reversed(list(enumerate(kind.__mro__)))
        for name in inspect.get_annotations(base)
    }
    headings = {
        name: heading
        for base in kind.__mro__
        for heading, names in vars(base).get("headings", {}).items()
        for name in names
    }

    def place(one: "Field[Any]") -> tuple[bool, bool, int]:
        return one.default is not MISSING, one.name in _LAST, level[one.name]

    under: dict[str, list[tuple[str, Any, Any]]] = {"": []}
    for one in sorted(fields(kind), key=place):
        about = texts.get(one.name, ""), _when(kind, noted.get(one.name, []))
        heading = headings.get(one.name, "")
        shown = tyro.conf.arg(
            help=" ".join(filter(None, about)),
            metavar=_metavar(one.name, hints[one.name]),
            help_behavior_hint=lambda text: "" if text in _EMPTY else f"(default: {text})",
            prefix_name=not heading,
        )
        option: Any = Annotated[hints[one.name], shown]
        under.setdefault(heading, []).append((one.name, option, field(default=one.default)))
    own = under.pop("")
    for number, (heading, options) in enumerate(under.items()):
        name = f"options_{number}"
        group = make_dataclass(name, options, frozen=True, kw_only=True)
        own.append((name, Annotated[group, tyro.conf.arg(name=heading, help="")], field()))
    return make_dataclass(
        kind.__name__, own, namespace={"__doc__": kind.__doc__}, frozen=True, kw_only=True
    )


def _documentation(kind: type) -> dict[str, str]:
    """Read the docstring below each field in the source, without line breaks."""
    texts = {}
    for base in reversed(kind.__mro__):
        try:
            source = textwrap.dedent(inspect.getsource(base))
        except (OSError, TypeError):
            # The source of the class is not in a file.
            continue
        for known, text in itertools.pairwise(ast.parse(source).body[0].body):  # type: ignore[attr-defined]
            match known, text:
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
    unit = within(hint, Unit)
    word = "" if unit is None else (unit.suffix or unit.word).upper()
    word = {"D": "DAYS"}.get(word, word)
    word = f"INT|{word}" if word and int in choices_and_types(hint)[1] else word
    if several and Ellipsis not in several[0]:
        return " ".join(word or kind.__name__.upper() for kind in several[0])
    return f"{word} [{word} ...]" if word and several else word or None


def is_positional(hint: Any) -> bool:
    """Return whether a parameter is written without the name of an option."""
    return get_args(tyro.conf.Positional[int])[1] in getattr(hint, "__metadata__", ())
