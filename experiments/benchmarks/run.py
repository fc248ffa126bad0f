"""Run all benchmarks, one after another, and make a table of their rows.

    make bench                      # print the table, and write it to docs/pages/benchmarks.md
    make bench JSON=bench.json      # also write the rows as JSON
    python experiments/benchmarks/run.py --gpu gpu.json     # add a column of our times on a GPU,
                                                            # from the JSON of another machine

Each `bench_*.py` of this folder runs in a process of its own. Its output is written to
`runs/bench/NAME.txt`. If a script fails, the others still run, the page does not change, and the
exit status is 1. `rows.py` has the rules for a benchmark.
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
# The entry for the time of a peer that fails.
MISSING = "-"
FILE_WIDTH = 140
HEAD = ("", "what", "size", "jaxcell", "on a GPU", "peer", "peer takes", "ratio")
# The number of the column of the GPU, which is omitted without its times.
GPU = HEAD.index("on a GPU")
Elsewhere = Mapping[tuple[str, str, str], float]


@dataclass(frozen=True)
class Outcome:
    """The result of a script; `error` is a message if it failed."""

    rows: list[Row]
    seconds: float
    error: str | None = None


def run(script: Path, logs: Path) -> Outcome:
    """Run a script, and read its rows."""
    name = script.stem.removeprefix("bench_")
    log, rows = logs / f"{name}.txt", logs / f"{name}.json"
    rows.unlink(missing_ok=True)
    began = time.perf_counter()
    with log.open("w") as file:
        command = [sys.executable, str(script), "--rows", str(rows)]
        status = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT).returncode
    seconds = time.perf_counter() - began
    if status:
        last = (log.read_text(errors="replace").strip() or "no output").splitlines()[-1]
        return Outcome([], seconds, f"exit status {status}: {last} (see {log})")
    try:
        return Outcome(read_rows(rows), seconds)
    except (ValueError, OSError) as error:
        return Outcome([], seconds, f"no rows: {error} (see {log})")


def run_all(scripts: Sequence[Path], logs: Path) -> dict[str, Outcome]:
    """Run scripts one after another, and print the progress on standard error."""
    logs.mkdir(parents=True, exist_ok=True)
    screen, began = Console(stderr=True, highlight=False, soft_wrap=True), time.perf_counter()
    outcomes = {}
    for number, script in enumerate(scripts, 1):
        passed = time.perf_counter() - began
        with screen.status(f"{script.name}, {number} of {len(scripts)}, {passed:.0f} s so far ..."):
            outcomes[script.name] = outcome = run(script, logs)
        result = f"FAILED: {outcome.error}" if outcome.error else f"{len(outcome.rows)} rows"
        screen.print(f"{script.name:28} {outcome.seconds:5.0f} s  {result}", markup=False)
    return outcomes


def seconds_text(seconds: float | None) -> str:
    """Write seconds as s or ms."""
    if seconds is None:
        return ""
    unit, factor = ("s", 1.0) if seconds >= 1 else ("ms", 1e-3)
    return f"{two_digits(seconds / factor)} {unit}"


def two_digits(value: float) -> str:
    """Write a number with two significant digits, or as a whole number."""
    return f"{value:,.{0 if value >= 9.95 else 1 if value >= 0.995 else 2}f}"


def read_elsewhere(path: Path) -> Elsewhere:
    """Read our seconds in each row of a file that `--json` wrote on another machine.

    **Raises:** `ValueError` if the file has no rows, `OSError` if there is no file.
    """
    try:
        rows = [Row.from_json(entry) for entry in json.loads(path.read_text())["rows"]]
    except (KeyError, TypeError) as error:
        raise ValueError(f"expected a file of --json, got no rows: {error!r}") from None
    return {(row.benchmark, row.what, row.size): row.ours_s for row in rows}


def columns(cells: Sequence[str], gpu: Elsewhere) -> tuple[str, ...]:
    """Omit the column of the GPU if there are no times for it."""
    return tuple(cell for number, cell in enumerate(cells) if gpu or number != GPU)


def cells_of(row: Row, gpu: Elsewhere) -> tuple[str, ...]:
    """Write the entries of a row as text."""
    ratio = "" if row.ratio is None else two_digits(row.ratio)
    theirs = MISSING if row.peer and row.peer_s is None else seconds_text(row.peer_s)
    ours = seconds_text(row.ours_s)
    there = seconds_text(gpu.get((row.benchmark, row.what, row.size)))
    cells = (row.benchmark, row.what, row.size, ours, there, row.peer or "", theirs, ratio)
    return columns(cells, gpu)


def setting(versions: dict[str, str | None], machine: dict[str, Any]) -> str:
    """Write the machine and the versions as one line."""
    found = ", ".join(f"{name} {number or '(not installed)'}" for name, number in versions.items())
    return (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB, "
        f"{machine['system']}, JAX on {machine['device']}, Python {machine['python']}, "
        f"{machine['date']}, "
        f"load {machine['load']} at the start. {found}. "
        f"{MISSING}: the peer fails."
    )


def markdown(rows: Sequence[Row], setting: str, gpu: Elsewhere) -> str:
    """Make a table of all rows, with the machine and the versions below."""
    rules = ("---", "---", "---", "--:", "--:", "---", "--:", "--:")
    lines = [columns(line, gpu) for line in (HEAD, rules)] + [cells_of(row, gpu) for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + f"\n\n{setting}\n"


def show(rows: Sequence[Row], setting: str, gpu: Elsewhere) -> None:
    """Print the table of all rows."""
    table = Table(*columns(HEAD, gpu), caption=setting, caption_justify="left")
    words = (*HEAD[:3], "peer")
    for column in table.columns:
        column.overflow, column.justify = "fold", "left" if column.header in words else "right"
    for row in rows:
        table.add_row(*map(escape, cells_of(row, gpu)))
    (Console() if Console().is_terminal else Console(width=FILE_WIDTH)).print(table)


def between_markers(text: str, new: str) -> str:
    """Replace the text between the lines `BEGIN` and `END` by `new`.

    **Raises:** `ValueError` unless the text has each marker once, in this order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"expected {BEGIN} and {END} once each, in this order")
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{new}{END}{rest.split(END)[1]}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the rows")
    parser.add_argument("--gpu", type=Path, metavar="FILE", help="JSON of a machine with a GPU")
    parser.add_argument("--page", type=Path, default=PAGE, help="page for the table")
    parser.add_argument("--scripts", type=Path, default=HERE, help="folder of bench_*.py")
    logs = ROOT / "runs" / "bench"
    parser.add_argument("--logs", type=Path, default=logs, help="folder for their output")
    arguments = parser.parse_args(argv)
    # Errors in the options are found before the scripts run for minutes.
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
    caption = setting(**found)
    outcomes = run_all(sorted(arguments.scripts.glob("bench_*.py")), arguments.logs)
    failed = [name for name, outcome in outcomes.items() if outcome.error is not None]
    rows = [row for outcome in outcomes.values() for row in outcome.rows]
    show(rows, caption, gpu)
    if arguments.json is not None:
        taken = {name: outcome.seconds for name, outcome in outcomes.items()}
        whole = {**found, "scripts_s": taken, "failed": failed}
        whole["rows"] = [row.to_json() for row in rows]
        with replacing(arguments.json) as file:
            file.write_text(json.dumps(whole, indent=1) + "\n")
    if failed or not rows:
        reason = f"failed: {', '.join(failed)}" if failed else "there are no benchmarks"
        print(f"{reason}; {arguments.page.name} is unchanged", file=sys.stderr)
        return 1
    with replacing(arguments.page) as file:
        file.write_text(between_markers(arguments.page.read_text(), markdown(rows, caption, gpu)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
