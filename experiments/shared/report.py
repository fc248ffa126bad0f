"""Print tables, remarks and progress, write tables as CSV, and compute intervals of shares."""

import csv
import math
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import binomtest


WIDTH = 110
Rows = list[dict[str, Any]]


def emit(title: str, rows: Rows, path: Path, spec: str = ".3f", **specs: str) -> None:
    """Print a table as `show` does, and write it as CSV with all digits."""
    write_csv(rows, path)
    show(title, rows, spec, **specs)


def write_csv(rows: Rows, path: Path) -> None:
    """Write a table whose columns are the keys of its first row."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def show(title: str, rows: Rows, spec: str = ".3f", **specs: str) -> None:
    """Print a table whose columns are the keys of its first row.

    Headings break at commas. An entry of the first column that repeats the one above is left out.

    **Arguments:**

    - `spec`: format of the numbers that are not whole.
    - `specs`: formats of single columns, by their names.
    """
    names = list(rows[0])
    table = Table(title=title, box=SIMPLE_HEAD)
    for name in names:
        words = all(isinstance(row.get(name, ""), str) for row in rows)
        heading = name.replace(", ", "\n")
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    before = None
    for row in rows:
        first, *others = [shown(row.get(name), specs.get(name, spec)) for name in names]
        table.add_row("" if first == before else first, *others)
        before = first
    # A narrower console would truncate entries.
    Console(width=max(WIDTH, Console(width=1000).measure(table).maximum)).print(table)


def shown(value: Any, spec: str) -> str:
    """Format an entry of a table; missing numbers are empty."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return format(value, spec) if isinstance(value, float) else str(value)


def say(*paragraphs: str) -> None:
    """Print paragraphs, and an empty line."""
    for text in paragraphs:
        print(textwrap.fill(" ".join(text.split()), WIDTH))
    print()


def tracked(items: Iterable[Any], title: str, total: int | None = None) -> Iterable[Any]:
    """Yield items, and show a progress bar on a terminal."""
    console = Console(stderr=True)
    hidden = not console.is_terminal
    return track(items, title, total, transient=True, console=console, disable=hidden)


def interval(successes: int, trials: int, method: str = "wilson") -> tuple[float, float]:
    """Compute the 95 % confidence interval of a share."""
    bounds = binomtest(successes, trials).proportion_ci(method=method)
    return float(bounds.low), float(bounds.high)
