"""What people see: tables on standard output, progress and remarks on standard error."""

import contextlib
import ctypes
import math
import os
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status
from rich.table import Table


if TYPE_CHECKING:
    from ..space import CellSpace


def status(text: str) -> Status:
    """Shows on a terminal that work goes on."""
    return Console(stderr=True).status(text + " ...")


def note_results(results: Path) -> None:
    """Says where the results are, and how to look at them from this shell."""
    note(f"Results are in {results}; to look at them: {own_command('jaxcell')} view {results}")


def own_command(name: str) -> str:
    """How to call a command of this Python's environment from this shell."""
    # A virtual environment that is not activated has its commands beside its Python.
    beside = Path(sys.executable).with_name(name)
    return name if shutil.which(name) else min(str(beside), os.path.relpath(beside), key=len)


def note(text: str) -> None:
    """A remark for people."""
    Console(stderr=True).print(text, highlight=False, soft_wrap=True, markup=False)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints a table with numbers to the right."""
    body = [[f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row] for row in rows]
    grid = Table(title=title, title_justify="left", title_style="bold")
    for i, column in enumerate(columns):
        numeric = all(row[i].replace(",", "").replace(".", "").isdigit() for row in body)
        grid.add_column(column, justify="right" if body and numeric else "left")
    for row in body:
        grid.add_row(*row)
    Console().print(grid)


def count_cells(cells: "CellSpace") -> str:
    """The size of a cell space as people read it."""
    return f"{cells.positions:,} positions x {cells.directions} directions = {cells.size:,} cells"


def configuration(cells: "CellSpace", z: int, heading: bool = True) -> str:
    """A cell, or a position, as people read it: its number and its pose."""
    if z < 0:
        return "none"
    x, y, theta = cells.centre(z)
    facing = f", {math.degrees(float(theta)):g}°" if heading else ""
    return f"{z} ({float(x):g} m, {float(y):g} m{facing})"


@contextlib.contextmanager
def solver_on_stderr() -> Iterator[None]:
    """Keeps the standard output for results: HiGHS tells some of its troubles there."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        # What C has in its buffer would come later.
        with contextlib.suppress(TypeError, OSError):
            ctypes.CDLL(None).fflush(None)
        os.dup2(kept, 1)
        os.close(kept)
