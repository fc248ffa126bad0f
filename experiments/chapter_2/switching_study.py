"""Measure the localization of a robot that chooses among bouncing angles in 1,000 random rooms.

    python -m experiments.chapter_2.switching_study --rooms 1000

The rooms are those of `angle_study.py`: 50 x 45 cells with six random rectangles in them, about
2,000 free cells, here with eight directions. The robot knows neither its place nor its heading.

- For every set of one, two or three of the seven angles: the number of rooms where all cells can be
  distinguished, so that it is localized to one cell from everywhere.
- For one angle, two and three (`SEARCHED`): the fewest bumps that a choice of angles needs at worst
  and in the mean, and those of the shortest fixed sequence; all proved, or counted as not.

A thousand rooms, at some 2 s of a core each, say: one angle tells all cells apart in few rooms (135
and 225 deg in 23 %, 45 and 315 deg in 4 % at most, 90, 180 and 270 deg in none). Of the 21 pairs 15
do in all rooms. The others are 45 and 90 deg, which fail in 3 rooms, and their mirror image, 270
and 315 deg, in 6; 45 and 315 deg (42 % of rooms); and two multiples of 90 deg (20 %, also with all
three of them). Bumps of the best choice, proved in all rooms: with 135 deg alone 7 at worst (median
over rooms; 11 in the worst room) and 3.48 in the mean, though not always to one cell; with 45 and
135 deg 6 (12) and 3.47; with 45, 90 and 135 deg 5 (9) and 3.31. A fixed sequence takes 7 (11), 7
(24) and 6 (14).

The study is resumable: each room is a line of `rooms.jsonl`, and only those that are missing are
looked at. Writes `summary.json` beside it.
"""

import concurrent.futures
import itertools
import json
import os
import time
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from jaxcell.automata import adaptive_choice, homing_sequence
from jaxcell.automata.adaptive import levels
from jaxcell.bounce import Roadmap
from jaxcell.space import CellSpace
from jaxcell.space.maps.random_rooms import random_room

from ..shared.options import at_least, experiment_parser, read_options


DIRECTIONS = 8
SETS = [one for n in (1, 2, 3) for one in itertools.combinations(range(1, DIRECTIONS), n)]
SEARCHED = [(3,), (1, 3), (1, 2, 3)]


def named(shifts: tuple[int, ...]) -> str:
    """The angles of a set, in degrees."""
    return " ".join(str(360 * shift // DIRECTIONS) for shift in shifts)


def study_room(seed: int, room: int) -> dict[str, Any]:
    """The classes of cells for each set of angles, and the bumps for some."""
    cells = CellSpace.of_grid(random_room(seed, room, 50, 45, 6), DIRECTIONS)
    apart, searched = {}, {}
    for shifts in SETS:
        roadmap = Roadmap.of(cells, 2 * np.pi * np.array(shifts) / DIRECTIONS)
        images, lengths = roadmap.wall[roadmap.turned], roadmap.length[roadmap.turned]
        behind = np.bincount(roadmap.wall) - 1
        label = levels(images, lengths)[-1]
        # Cells are told apart by their walls, and on a line by how far they are from it.
        farthest = np.zeros(label.max() + 1, np.int64)
        np.maximum.at(farthest, label, behind)
        apart[named(shifts)] = int((farthest + 1).sum())
        if shifts in SEARCHED:
            searched[named(shifts)] = bumps(images, lengths, behind)
    return {"room": room, "cells": cells.size, "apart": apart, "bumps": searched}


def bumps(images: np.ndarray, lengths: np.ndarray, behind: np.ndarray) -> dict[str, Any]:
    roots = [np.flatnonzero(behind >= steps) for steps in range(int(behind.max()) + 1)]
    worst = adaptive_choice(images, lengths, roots)
    mean = adaptive_choice(images, lengths, roots, aim="mean")
    fixed = homing_sequence(images, lengths, roots)
    return {
        "worst": 1 + max(worst.upper),
        "mean": 1 + sum(mean.upper) / int((behind + 1).sum()),
        "fixed": 1 + fixed.inputs.size,
        "proved": [worst.optimal, mean.optimal, fixed.optimal],
    }


def report(rooms: list[dict[str, Any]]) -> dict[str, Any]:
    console = Console()
    whole = {
        named(shifts): np.mean([one["apart"][named(shifts)] == one["cells"] for one in rooms])
        for shifts in SETS
    }
    table = Table(title=f"{len(rooms):,} rooms: where all cells are told apart", box=SIMPLE_HEAD)
    for column in ("angles", "rooms", "cells told apart, least"):
        table.add_column(column, justify="right")
    for name, share in whole.items():
        least = min(one["apart"][name] / one["cells"] for one in rooms)
        table.add_row(name, f"{share:.1%}", f"{least:.1%}")
    console.print(table)
    serve = [named(s) for s in SETS if len(s) == 2 and whole[named(s)] == 1]
    print(f"pairs that serve all rooms: {'; '.join(serve) or 'none'}")

    table = Table(title="Bumps until localized: median, largest", box=SIMPLE_HEAD)
    for column in ("angles", "at worst", "most", "mean", "most", "fixed", "most", "proved"):
        table.add_column(column, justify="right")
    needed = {}
    for shifts in SEARCHED:
        ones = [one["bumps"][named(shifts)] for one in rooms]
        numbers = {}
        for kind in ("worst", "mean", "fixed"):
            values = np.array([one[kind] for one in ones])
            numbers[kind] = {"median": float(np.median(values)), "most": float(values.max())}
        proved = float(np.mean([all(one["proved"]) for one in ones]))
        needed[named(shifts)] = numbers | {"proved": proved}
        row = [f"{x:.3g}" for kind in numbers.values() for x in kind.values()]
        table.add_row(named(shifts), *row, f"{proved:.1%}")
    console.print(table)
    return {
        "rooms": len(rooms),
        "all_cells_told_apart": {name: float(share) for name, share in whole.items()},
        "pairs_for_all_rooms": serve,
        "bumps": needed,
    }


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/switching_study", seed=0)
    parser.add_argument("--rooms", type=at_least(1), default=20)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = read_options(parser)

    path, began = options.out / f"rooms_{options.seed}.jsonl", time.perf_counter()
    lines = path.read_text().splitlines() if path.exists() else []
    done = {one["room"]: one for one in map(json.loads, lines)}
    missing = [room for room in range(options.rooms) if room not in done]
    with (
        concurrent.futures.ProcessPoolExecutor(options.workers) as pool,
        path.open("a") as file,
    ):
        for one in pool.map(study_room, itertools.repeat(options.seed), missing):
            done[one["room"]] = one
            file.write(json.dumps(one) + "\n")
            file.flush()
    summary = report([done[room] for room in range(options.rooms)])
    (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    print(f"{len(missing):,} rooms in {time.perf_counter() - began:.0f} s; in {options.out}")


if __name__ == "__main__":
    main()
