"""Runs all benchmarks, one after the other, and makes one table of their rows.

    make bench                      # the table is printed, and docs/pages/benchmarks.md shows it
    make bench JSON=bench.json      # and the rows are written as JSON
    python experiments/benchmarks/run.py --gpu gpu.json     # with a column of ours on a GPU, from
                                                            # the JSON of a machine that has one

Each `bench_*.py` of this folder runs in a process of its own. What it prints is kept in
`runs/bench/NAME.txt`. Where one fails, the others go on, the page stays as it is, and the exit
status is 1. `rows.py` says what a benchmark must do to be in the table.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machine import machine, versions
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rows import Row, read_rows

from jaxcell.base.paths import replacing


HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "pages" / "benchmarks.md"
BEGIN, END = "<!-- bench -->", "<!-- /bench -->"
# For the time of a peer that cannot do it.
MISSING = "-"
FILE_WIDTH = 140
HEAD = ("", "what", "size", "jaxcell", "on a GPU", "peer", "peer takes", "ratio")
# The column of the GPU, which is left out where none was measured.
GPU = HEAD.index("on a GPU")
Elsewhere = Mapping[tuple[str, str, str], float]


@dataclass(frozen=True)
class Outcome:
    """The end of a script; `error` is a line for people if it failed."""

    rows: list[Row]
    seconds: float
    error: str | None = None


def run(script: Path, logs: Path) -> Outcome:
    """Runs a script, and collects its rows."""
    name = script.stem.removeprefix("bench_")
    log, rows = logs / f"{name}.txt", logs / f"{name}.json"
    rows.unlink(missing_ok=True)
    began = time.perf_counter()
    with log.open("w") as file:
        command = [sys.executable, str(script), "--rows", str(rows)]
        status = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT).returncode
    seconds = time.perf_counter() - began
    if status:
        last = (log.read_text(errors="replace").strip() or "it said nothing").splitlines()[-1]
        return Outcome([], seconds, f"exit status {status}: {last} (see {log})")
    try:
        return Outcome(read_rows(rows), seconds)
    except (ValueError, OSError) as error:
        return Outcome([], seconds, f"no rows: {error} (see {log})")


def run_all(scripts: Sequence[Path], logs: Path) -> dict[str, Outcome]:
    """Runs scripts one after the other, and tells on standard error how far it is."""
    logs.mkdir(parents=True, exist_ok=True)
    screen, began = Console(stderr=True, highlight=False, soft_wrap=True), time.perf_counter()
    outcomes = {}
    for number, script in enumerate(scripts, 1):
        passed = time.perf_counter() - began
        with screen.status(f"{script.name}, {number} of {len(scripts)}, {passed:.0f} s so far ..."):
            outcomes[script.name] = outcome = run(script, logs)
        told = f"{len(outcome.rows)} rows" if outcome.error is None else f"FAILED: {outcome.error}"
        screen.print(f"{script.name:28} {outcome.seconds:5.0f} s  {told}", markup=False)
    return outcomes


def seconds_text(seconds: float | None) -> str:
    """Seconds in the unit that people would take."""
    if seconds is None:
        return ""
    unit, factor = ("s", 1.0) if seconds >= 1 else ("ms", 1e-3)
    return f"{two_digits(seconds / factor)} {unit}"


def two_digits(value: float) -> str:
    """A number with two digits that count, or with all before the point."""
    return f"{value:,.{0 if value >= 9.95 else 1 if value >= 0.995 else 2}f}"


def read_elsewhere(path: Path) -> Elsewhere:
    """Our seconds in each row that `--json` wrote on another machine.

    **Raises:** `ValueError` if the file holds no rows, `OSError` if there is none.
    """
    try:
        rows = [Row.from_json(entry) for entry in json.loads(path.read_text())["rows"]]
    except (KeyError, TypeError) as error:
        raise ValueError(f"expected what --json writes, got no rows: {error!r}") from None
    return {(row.benchmark, row.what, row.size): row.ours_s for row in rows}


def columns(cells: Sequence[str], gpu: Elsewhere) -> tuple[str, ...]:
    """The columns that are shown."""
    return tuple(cell for number, cell in enumerate(cells) if gpu or number != GPU)


def cells_of(row: Row, gpu: Elsewhere) -> tuple[str, ...]:
    """The row as it is shown."""
    ratio = "" if row.ratio is None else two_digits(row.ratio)
    theirs = MISSING if row.peer and row.peer_s is None else seconds_text(row.peer_s)
    ours = seconds_text(row.ours_s)
    there = seconds_text(gpu.get((row.benchmark, row.what, row.size)))
    cells = (row.benchmark, row.what, row.size, ours, there, row.peer or "", theirs, ratio)
    return columns(cells, gpu)


def setting(versions: dict[str, str | None], machine: dict[str, Any]) -> str:
    """One line for people of what was timed on what."""
    told = ", ".join(f"{name} {found or '(not installed)'}" for name, found in versions.items())
    return (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB, "
        f"{machine['system']}, JAX on {machine['device']}, Python {machine['python']}, "
        f"{machine['date']}, "
        f"load {machine['load']} at the start. {told}. "
        f"{MISSING}: the peer cannot do it."
    )


def markdown(rows: Sequence[Row], setting: str, gpu: Elsewhere) -> str:
    """The table of all rows, and below it what was timed on what."""
    rules = ("---", "---", "---", "--:", "--:", "---", "--:", "--:")
    lines = [columns(line, gpu) for line in (HEAD, rules)] + [cells_of(row, gpu) for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + f"\n\n{setting}\n"


def show(rows: Sequence[Row], setting: str, gpu: Elsewhere) -> None:
    """Prints the table of all rows."""
    table = Table(*columns(HEAD, gpu), caption=setting, caption_justify="left")
    words = (*HEAD[:3], "peer")
    for column in table.columns:
        column.overflow, column.justify = "fold", "left" if column.header in words else "right"
    for row in rows:
        table.add_row(*map(escape, cells_of(row, gpu)))
    (Console() if Console().is_terminal else Console(width=FILE_WIDTH)).print(table)


def between_markers(text: str, new: str) -> str:
    """The text with `new` between the lines `BEGIN` and `END`.

    **Raises:** `ValueError` unless the text has each marker once, in this order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"expected {BEGIN} and {END} once each, in this order")
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{new}{END}{rest.split(END)[1]}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows here")
    parser.add_argument("--gpu", type=Path, metavar="FILE", help="the JSON of a GPU's machine")
    parser.add_argument("--page", type=Path, default=PAGE, help="shows the table")
    parser.add_argument("--scripts", type=Path, default=HERE, help="the folder of bench_*.py")
    parser.add_argument("--logs", type=Path, default=ROOT / "runs" / "bench", help="what they say")
    arguments = parser.parse_args(argv)
    # Before it takes minutes.
    try:
        between_markers(arguments.page.read_text(), "")
    except ValueError as error:
        parser.error(f"{arguments.page}: {error}")
    if arguments.json is not None and not arguments.json.absolute().parent.is_dir():
        parser.error(f"--json {arguments.json}: there is no such folder")
    try:
        gpu = {} if arguments.gpu is None else read_elsewhere(arguments.gpu)
    except (ValueError, OSError) as error:
        parser.error(f"--gpu {arguments.gpu}: {error}")
    found = {"versions": versions(), "machine": machine()}
    told = setting(**found)
    outcomes = run_all(sorted(arguments.scripts.glob("bench_*.py")), arguments.logs)
    failed = [name for name, outcome in outcomes.items() if outcome.error is not None]
    rows = [row for outcome in outcomes.values() for row in outcome.rows]
    show(rows, told, gpu)
    if arguments.json is not None:
        taken = {name: outcome.seconds for name, outcome in outcomes.items()}
        whole = {**found, "scripts_s": taken, "failed": failed}
        whole["rows"] = [row.to_json() for row in rows]
        with replacing(arguments.json) as file:
            file.write_text(json.dumps(whole, indent=1) + "\n")
    if failed or not rows:
        reason = f"failed: {', '.join(failed)}" if failed else "there are no benchmarks"
        print(f"{reason}; {arguments.page.name} stays as it is", file=sys.stderr)
        return 1
    with replacing(arguments.page) as file:
        file.write_text(between_markers(arguments.page.read_text(), markdown(rows, told, gpu)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
