"""Output for people: tables on standard output, progress and remarks on standard error."""

import contextlib
import os
import re
import shlex
import shutil
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

from rich.console import Console
from rich.table import Table

from ..base.doubts import Doubt
from ..base.optional_modules import has_module
from ..base.process import output_to
from ..base.quantities import Result
from .encoding import encodable
from .help import as_options


FIRST_LINE, LINES = 1.5, 60.0
"""Without a terminal: seconds before the first line of progress, and between further lines."""


@contextlib.contextmanager
def status(
    text: str, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[str], None]]:
    """Show that work is in progress: a spinner on a terminal, elsewhere a line every minute.

    Yields a function that changes the text. `clock` returns a time in seconds.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(text + " ...") as shown:
            yield lambda text: shown.update(text + " ...")
        return
    ended, began, now = threading.Event(), clock(), [text]

    def report() -> None:
        wait = FIRST_LINE
        while not ended.wait(wait):
            wait = LINES
            note(f"{now[0]} ... ({duration(clock() - began)})")

    reporter = threading.Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield lambda text: now.__setitem__(0, text)
    finally:
        ended.set()
        reporter.join()


@contextlib.contextmanager
def progress(
    text: str, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[..., None]]:
    """Show the current work, its progress, and an estimate of the remaining time.

    Yields a function to call with the name of the work, the amount done, the total amount, and
    further text. `clock` returns a time in seconds.
    """
    with status(text, clock) as change:
        current, began, first = None, 0.0, 0

        def say(doing: str, done: int = 0, total: int = 0, more: str = "") -> None:
            nonlocal current, began, first
            if doing != current:
                current, began, first = doing, clock(), done
            if not total:
                change(doing)
                return
            parts = [f"{doing}: {done:,} of {total:,}", more]
            if done > first:
                each = (clock() - began) / (done - first)
                parts.append(f"{duration(each * (total - done))} left")
            change(", ".join(filter(None, parts)))

        yield say


def duration(seconds: float) -> str:
    """Format a time as hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def note_results(results: Path) -> None:
    """Print the folder of the results, and the command that shows them if Rerun is installed."""
    advice = f"; to look at them: {own_command('view', results)}"
    note(f"Results are in {results}{advice if has_module('rerun') else '.'}")


def own_command(*words: str | Path) -> str:
    """Return a command line of `jaxcell` for a shell; the command has its path if not on PATH."""
    # The commands of a virtual environment that is not active are in the folder of its Python.
    beside = Path(sys.executable).with_name(name := "jaxcell")
    name = name if shutil.which(name) else min(str(beside), os.path.relpath(beside), key=len)
    return shlex.join([name, *map(str, words)])


def say(text: str) -> None:
    """Print and flush a line on standard output, so that remarks on standard error follow it."""
    print(text, flush=True)


def note(text: str) -> None:
    """Print a remark on standard error."""
    Console(stderr=True).print(text, highlight=False, soft_wrap=True, markup=False, emoji=False)


@contextlib.contextmanager
def noting_warnings(command: type) -> Iterator[list[str]]:
    """Print each `UserWarning` and `Doubt` once as a remark, and yield the list of their texts.

    Names of parameters of the `command` become names of options.
    """
    noted: list[str] = []
    with warnings.catch_warnings():
        shown = warnings.showwarning

        def show(message: Any, category: Any, *place: Any) -> None:
            text = as_options(command, str(message))
            if category not in (UserWarning, Doubt):
                shown(message, category, *place)
            elif text not in noted:
                noted.append(text)
                note(text)

        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = cast(Any, show)
        yield noted


def show(result: Result, heading: str) -> None:
    """Print the answer of a result, and its tables under a heading.

    A terminal would break sentences within words, other programs read a sentence per line.
    """
    from ..record.data.tables import tables

    console = Console()
    for line in result.answer:
        say(_wrapped(line, console.width) if console.is_terminal else line)
    for each in tables(result, heading):
        table(*each)
    if result.brief:
        say("The rest is in the files of --out, and in --json.")


# A number, alone or with its unit, or an infinite extent.
_NUMBER = re.compile(r"((over|<) )?-?[\d,.]+(e[-+]\d+)?(°| [^\s\d]+)?|anywhere")
# The space between a number and its unit is replaced while lines are broken.
_INSIDE, _JOINED = re.compile(r"(?<=\d) (?=[^\W\d]|%)|(?<=\(cell) (?=\d)"), "\0"


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; columns of numbers are aligned to the right.

    Words, and numbers with their units, are not broken. A table that is too wide is transposed, if
    it has fewer rows than columns; or each of its cells has a row, or a line of text.
    """
    console = Console(markup=False, emoji=False, highlight=False)
    title, *columns = (encodable(text, console.encoding) for text in (title, *columns))
    body = [
        [
            f"{cell:,}" if isinstance(cell, int) else encodable(str(cell), console.encoding)
            for cell in row
        ]
        for row in rows
    ]
    console.print(title, style="bold")
    for heads, lines in _layouts(columns, body):
        if widths := _widths(heads, lines, console.width):
            console.print(_grid(heads, lines, widths))
            return
    for head, cell in _in_turn(columns, body):
        print(_filled(f"{head}: {cell}" if cell else "", console.width))


def _layouts(
    columns: Sequence[str], body: Sequence[Sequence[str]]
) -> Iterator[tuple[Sequence[str], Sequence[Sequence[str]]]]:
    """Yield the heads and rows of a table in several layouts, the widest first."""
    yield columns, body
    if len(body) < len(columns):
        heads, *turned = map(list, zip(columns, *body, strict=True))
        yield heads, turned
    yield ("quantity", "value"), _in_turn(columns, body)


def _in_turn(columns: Sequence[str], body: Sequence[Sequence[str]]) -> list[tuple[str, str]]:
    """List the cells of each row with their heads; an empty pair follows a row."""
    rows = [[(head, cell) for head, cell in zip(columns, row, strict=True) if cell] for row in body]
    return [pair for row in rows for pair in (*row, ("", ""))]


def _grid(columns: Sequence[str], body: Sequence[Sequence[str]], widths: Sequence[int]) -> Table:
    grid = Table()
    for head, width, *cells in zip(columns, widths, *body, strict=True):
        numeric = all(_NUMBER.fullmatch(cell) for cell in cells)
        grid.add_column(head, justify="right" if cells and numeric else "left", width=width)
    for row in body:
        if any(row):
            grid.add_row(*map(_filled, row, widths))
        else:
            grid.add_section()
    return grid


def _filled(cell: str, width: int) -> str:
    return "\n".join(_wrapped(line, width) for line in cell.split("\n"))


def _wrapped(line: str, room: int) -> str:
    """Break a line between words; a word that is longer than the room stays whole."""
    if len(line) <= room:
        return line
    return textwrap.fill(
        _INSIDE.sub(_JOINED, line), room, break_long_words=False, break_on_hyphens=False
    ).replace(_JOINED, " ")


def _widths(columns: Sequence[str], body: Sequence[Sequence[str]], room: int) -> list[int]:
    """Return the widths of columns that do not break words; empty if there is no room for them."""
    cells = list(zip(columns, *body, strict=True))
    wanted = [max(len(line) for cell in one for line in cell.split("\n")) for one in cells]
    widths = [
        max((len(word) for cell in one for word in _INSIDE.sub(_JOINED, cell).split()), default=0)
        for one in cells
    ]
    # Each column has a space on both sides, and a separating line.
    spare = room - 1 - sum(width + 3 for width in widths)
    if spare < 0:
        return []
    while spare and wanted != widths:
        shortest = max(range(len(widths)), key=lambda k: wanted[k] - widths[k])
        widths[shortest] += 1
        spare -= 1
    return widths


@contextlib.contextmanager
def stdout_on_stderr() -> Iterator[None]:
    """Redirect standard output, including that of child processes, to standard error."""
    with output_to(2), contextlib.redirect_stdout(sys.stderr):
        yield
