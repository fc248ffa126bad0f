"""Compute the smallest filters of labs and random rooms, and their bytes on microcontrollers.

    python -m experiments.chapter_2.smallest_filters --rooms 100

For each room and each bouncing angle that is a multiple of 45 deg, the table has the numbers of
states of the subset construction, of Moore's minimization, and of the smallest machine with the
same colours, and the lower bound that was proved within `--seconds`. A machine reads single
observations, or whole runs from bump to bump. Random rooms have 5 x 4 squares, of which up to three
are blocked. In the labs, robots also start anywhere in their cells.

The table of bytes compiles each header for an ATmega328, an ESP32-C3 (RISC-V) and an ESP8266, and
measures the microseconds of an observation on an ATmega328 at 16 MHz with the simulator simavr. A
column is empty if its program is not installed. The Xtensa cores of the ESP32 and ESP32-S3 are not
included.

The script writes `smallest_filters.csv`, `summary.csv`, `bytes.csv` and `smallest_filters.png`. The
first is written row by row, and the same command continues it.
"""

import csv
import itertools
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxcell import automata
from jaxcell.automata import Filter, MooreMachine
from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import Motion, Offsets, bounce_map, localization_filter
from jaxcell.space import CellSpace
from jaxcell.space.maps.random_rooms import random_room

from ..shared.data import MAPS
from ..shared.figures import plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit, say


ANGLES = tuple(range(45, 361, 45))
SIZE, OBSTACLES, SEED = (5, 4), 3, 0
LABS = ("lab_a", "lab_b")
READS = ("runs", "observations")
COLUMNS = ("room", "angle", "reads", "states", "moore", "smallest", "bound", "seconds")


def rooms(count: int) -> Iterator[tuple[str, CellSpace, bool]]:
    """Yield the name and the cells of each room, and `True` if robots start anywhere in a cell."""
    for name in LABS:
        yield name, CellSpace.load(MAPS / f"{name}.json"), False
    for number in range(count):
        free = random_room(SEED, number, *SIZE, OBSTACLES)
        yield f"room {number}", CellSpace.of_grid(free, 8), False
    for name in LABS:
        yield f"{name}, anywhere", CellSpace.load(MAPS / f"{name}.json"), True
    yield "complex", CellSpace.load(MAPS / "complex.json"), False


def filter_of(cells: CellSpace, angle: int, anywhere: bool) -> Filter:
    """Make the filter of an angle in degrees."""
    bounce = math.radians(angle)
    if anywhere:
        return localization_filter(Offsets.of(cells, motion=Motion()).bounce_map(bounce))
    return localization_filter(bounce_map(cells, bounce))


def study(path: Path, count: int, seconds: float) -> Rows:
    """Append the missing rows to the file, and return all rows, whose entries are strings."""
    done: Rows = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            done = list(csv.DictReader(file))
    known = {(row["room"], row["angle"], row["reads"]) for row in done}
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not done:
            writer.writeheader()
        for reads, (name, cells, anywhere), angle in itertools.product(
            READS, list(rooms(count)), ANGLES
        ):
            if (name, str(angle), reads) in known:
                continue
            machine = MooreMachine.of(filter_of(cells, angle, anywhere), runs=reads == "runs")
            found = automata.smallest(machine, seconds=seconds)
            sizes = len(machine.color), found.moore, found.states, found.bound
            values = map(str, (name, angle, reads, *sizes, f"{found.seconds:.2f}"))
            row = dict(zip(COLUMNS, values, strict=True))
            writer.writerow(row)
            file.flush()
            done.append(row)
            print(*row.values(), flush=True)
    return done


def summary(rows: Rows) -> Rows:
    """Tabulate the median sizes by kind of room and by inputs of the machine."""
    kinds = (*LABS, *(f"{name}, anywhere" for name in LABS), "complex", "room")
    lines = []
    for kind in kinds:
        for reads in ("observations", "runs"):
            chosen = [
                row
                for row in rows
                if row["reads"] == reads
                and (row["room"] == kind or (kind == "room" and row["room"].startswith("room ")))
            ]
            if not chosen:
                continue
            numbers = {name: np.array([int(row[name]) for row in chosen]) for name in COLUMNS[3:7]}
            proved = numbers["smallest"] == numbers["bound"]
            lines.append(
                {
                    "room": "random rooms" if kind == "room" else kind,
                    "reads": reads,
                    "filters": len(chosen),
                    **{name: float(np.median(numbers[name])) for name in COLUMNS[3:7]},
                    "proved": int(proved.sum()),
                    "Moore least": int((numbers["moore"] == numbers["bound"]).sum()),
                }
            )
    return lines


# The timer counts one eighth of the cycles of 500 observations. The simulator prints the output.
LOOP = """
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdio.h>
#include "lab.h"
static const uint8_t word[] PROGMEM = {%s};
volatile uint8_t sink;
static int put(char c, FILE *file) { (void)file; UDR0 = c; return 0; }
static FILE out = FDEV_SETUP_STREAM(put, 0, _FDEV_SETUP_WRITE);
int main(void) {
    lab_state state = LAB_START;
    stdout = &out;
    UCSR0B = 8;
    TCCR1B = 2;
    for (uint16_t i = 0; i < sizeof word; i++) {
        uint8_t observation = pgm_read_byte(&word[i]);
        %s
    }
    printf("eighths %%u\\n", (unsigned)TCNT1);
    cli();
    sleep_enable();
    sleep_cpu();
}
"""
READ = "state = lab_next(state, observation); sink = (uint8_t)lab_color(state);"


def headers(filter: Filter, seconds: float) -> Iterator[tuple[str, int, str]]:
    """Yield the name, the number of states, and the C header of each form of a filter."""
    yield "filter", len(filter.transition), automata.to_c_header(filter, name="lab")
    small = automata.minimize(filter)
    yield "Moore", len(small.transition), automata.to_c_header(small, name="lab")
    for runs in (False, True):
        machine = automata.smallest(MooreMachine.of(filter, runs=runs), seconds=seconds).machine
        name = "smallest, runs" if runs else "smallest, observations"
        yield name, len(machine.color), automata.machine_to_c_header(machine, name="lab")


COMPILERS = {
    "ATmega328": ("avr", ["-mmcu=atmega328p", "-DJAXCELL_PROGMEM"]),
    "ESP32-C3": ("riscv64-unknown-elf", ["-march=rv32imc", "-mabi=ilp32", "-ffreestanding"]),
    "ESP8266": ("xtensa-lx106-elf", ["-ffreestanding"]),
}


def counted(header: str, chip: str) -> tuple[int, int] | None:
    """Count the bytes of the tables and of the code of a header; `None` without a compiler."""
    prefix, flags = COMPILERS[chip]
    if shutil.which(f"{prefix}-gcc") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "lab.h").write_text(header)
        # External functions have symbols, by which their code is counted.
        Path(folder, "lab.c").write_text(
            '#include "lab.h"\nlab_state step(lab_state state, uint8_t observation) '
            "{ return lab_next(state, observation); }\n"
            "unsigned color(lab_state state) { return lab_color(state); }\n"
        )
        run = [f"{prefix}-gcc", "-std=c99", "-Os", *flags, "-c", "lab.c", "-o", "lab.o"]
        subprocess.run(run, check=True, cwd=folder)
        names = [f"{prefix}-nm", "-S", "lab.o"]
        text = subprocess.run(names, check=True, cwd=folder, capture_output=True, text=True).stdout
    sizes = re.findall(r"^\S+ (\S+) . (\S+)$", text, re.MULTILINE)
    tables = sum(
        int(size, 16) for size, name in sizes if name.startswith("lab_") and "." not in name
    )
    code = sum(int(size, 16) for size, name in sizes if name in ("step", "color"))
    return tables, code


def microseconds(header: str, word: list[int]) -> float | None:
    """Measure the time of an observation on an ATmega328 at 16 MHz; `None` without a simulator."""
    if shutil.which("avr-gcc") is None or shutil.which("simavr") is None:
        return None
    times = []
    # The second body is an empty loop, whose time is subtracted.
    for body in (READ, "(void)state; sink = observation;"):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "lab.h").write_text(header)
            Path(folder, "main.c").write_text(LOOP % (", ".join(map(str, word)), body))
            build = ["avr-gcc", "-std=gnu99", "-Os", "-mmcu=atmega328p", "-DJAXCELL_PROGMEM"]
            subprocess.run([*build, "main.c", "-o", "main.elf"], check=True, cwd=folder)
            run = ["simavr", "-m", "atmega328p", "-f", "16000000", "main.elf"]
            shown = subprocess.run(run, cwd=folder, capture_output=True, text=True, timeout=60)
        times.append(int(re.findall(r"eighths (\d+)", shown.stdout + shown.stderr)[0]))
    return (times[0] - times[1]) * 8 / 16 / len(word)


def bytes_table(seconds: float) -> Rows:
    """Tabulate the bytes and the time of each form of the filters of both labs."""
    lines: Rows = []
    for name in LABS:
        mapped = bounce_map(CellSpace.load(MAPS / f"{name}.json"), math.radians(135))
        filter = localization_filter(mapped)
        # The first 500 observations of a robot that starts in the first cell.
        cell, word = 0, []
        for _ in range(500):
            word.append(int(mapped.bumped[cell]))
            cell = int(mapped.image[cell])
        for form, states, header in headers(filter, seconds):
            line: dict[str, Any] = {"filter": f"{name}, 135°", "form": form, "states": states}
            for chip in COMPILERS:
                tables, code = counted(header, chip) or (None, None)
                line |= {f"{chip}, tables": tables, f"{chip}, code": code}
            lines.append({**line, "ATmega328, µs": microseconds(header, word)})
    return lines


def draw(rows: Rows, path: Path) -> None:
    """Draw the smallest sizes against the sizes of Moore's machines."""
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.6), layout="constrained")
    for axes, reads in zip(panels, ("observations", "runs"), strict=True):
        chosen = [row for row in rows if row["reads"] == reads]
        sizes = [[int(row[name]) for row in chosen] for name in ("moore", "smallest", "bound")]
        moore, smallest, bound = np.array(sizes)
        proved = smallest == bound
        for some, color, label in (
            (proved, "#0072b2", "proved smallest"),
            (~proved, "#d55e00", "not proved"),
        ):
            axes.plot(moore[some], smallest[some], ".", color=color, label=label, alpha=0.6)
        axes.vlines(moore[~proved], bound[~proved], smallest[~proved], color=color, alpha=0.4)
        limits = axes.get_xlim()
        axes.plot(limits, limits, color="0.7", linewidth=0.8, zorder=0)
        axes.set(xscale="log", yscale="log", xlabel="states, Moore", ylabel="states, smallest")
        axes.set_title(f"reads {reads}", fontsize=10)
        axes.legend(frameon=False)
    save(figure, path)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/smallest_filters")
    parser.add_argument("--rooms", type=at_least(0), default=100, help="number of random rooms")
    parser.add_argument("--seconds", type=float, default=20.0, help="time limit of each proof")
    parser.add_argument("--bytes-only", action="store_true", help="only the table of bytes")
    options = read_options(parser)

    configure_jax()
    if not options.bytes_only:
        rows = study(options.out / "smallest_filters.csv", options.rooms, options.seconds)
        emit("Median numbers of states", summary(rows), options.out / "summary.csv", ".0f")
        draw(rows, options.out / "smallest_filters.png")
    emit("Bytes after compilation", bytes_table(options.seconds), options.out / "bytes.csv", ".1f")
    say(f"Data and figure in {options.out}")


if __name__ == "__main__":
    main()
