"""Tables and remarks, for experiments with many of them."""

import csv
import math
import textwrap
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table


WIDTH = 110
Rows = list[dict[str, Any]]


def emit(title: str, rows: Rows, path: Path, spec: str = ".3f", **specs: str) -> None:
    """Prints a table, and writes it with all digits."""
    names = list(rows[0])
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    table = Table(title=title, box=SIMPLE_HEAD)
    for name in names:
        words = all(isinstance(row.get(name, ""), str) for row in rows)
        heading = name.replace(", ", "\n")
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    before = None
    for row in rows:
        told = [shown(row.get(name), specs.get(name, spec)) for name in names]
        table.add_row("" if told[0] == before else told[0], *told[1:])
        before = told[0]
    Console(width=WIDTH).print(table)


def shown(value: Any, spec: str) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return format(value, spec) if isinstance(value, float) else str(value)


def say(*paragraphs: str) -> None:
    for text in paragraphs:
        print(textwrap.fill(" ".join(text.split()), WIDTH))
    print()
