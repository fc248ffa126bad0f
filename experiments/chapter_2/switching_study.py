"""Measure the localization of a robot that chooses among bouncing angles in 1,000 random rooms.

    python -m experiments.chapter_2.switching_study --rooms 1000

The rooms are those of `angle_study.py`: 50 x 45 cells with six random rectangles in them, about
2,000 free cells, here with eight directions. The robot knows neither its place nor its heading.

- For each set of one, two or three of the seven angles, the script counts the rooms in which the
  angles distinguish all cells, so that the robot is localized to one cell from every start.
- For one set of each size (`SEARCHED`), it computes the fewest bumps that a choice of angles needs
  in the worst case and in the mean, and the length of the shortest fixed sequence. It counts the
  rooms in which these are proved to be optimal.

A thousand rooms take some 2 s of a core each. One angle distinguishes all cells in few rooms (135
and 225 deg in 23 %, 45 and 315 deg in at most 4 %, 90, 180 and 270 deg in none). Of the 21 pairs,
15 do so in all rooms. The exceptions are 45 and 90 deg, which fail in 3 rooms, and their mirror
image, 270 and 315 deg, in 6; 45 and 315 deg (42 % of rooms); and two multiples of 90 deg (20 %; all
three too). The best choices are proved in all rooms. With 135 deg alone, they need 7 bumps in
the worst case (median over rooms; 11 in the worst room) and 3.48 in the mean, though not always to
one cell; with 45 and 135 deg, 6 (12) and 3.47; with 45, 90 and 135 deg, 5 (9) and 3.31. A fixed
sequence needs 7 (11), 7 (24) and 6 (14).

Each room is a line of `rooms_SEED.jsonl`, and the same command computes only the missing rooms. The
script also writes `summary.json`.
"""

import concurrent.futures
import itertools
import json
import os
import time
from typing import Any

import numpy as np

from jaxcell.automata import adaptive_choice, homing_sequence
from jaxcell.automata.adaptive import levels
from jaxcell.bounce import walls
from jaxcell.space.maps.random_rooms import random_room

from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import show


DIRECTIONS = 8
SETS = [one for n in (1, 2, 3) for one in itertools.combinations(range(1, DIRECTIONS), n)]
SEARCHED = [(3,), (1, 3), (1, 2, 3)]


def named(shifts: tuple[int, ...]) -> str:
    """Name a set by its angles in degrees."""
    return " ".join(str(360 * shift // DIRECTIONS) for shift in shifts)


def study_room(seed: int, room: int) -> dict[str, Any]:
    """Count the classes of cells that each set of angles distinguishes, and bumps of some sets."""
    found = walls(random_room(seed, room, 50, 45, 6)[None], DIRECTIONS)
    apart, searched = {}, {}
    for shifts in SETS:
        images, lengths, behind = found.machine(shifts)
        label = levels(images, lengths)[-1]
        # Cells differ by the wall ahead, and behind the same wall by their distance from it.
        farthest = np.zeros(label.max() + 1, np.int64)
        np.maximum.at(farthest, label, behind)
        apart[named(shifts)] = int((farthest + 1).sum())
        if shifts in SEARCHED:
            searched[named(shifts)] = bumps(images, lengths, behind)
    return {"room": room, "cells": int((behind + 1).sum()), "apart": apart, "bumps": searched}


def bumps(images: np.ndarray, lengths: np.ndarray, behind: np.ndarray) -> dict[str, Any]:
    """Compute the bumps until localized, and if they are proved to be the fewest."""
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
    """Print the tables, and return their numbers."""
    whole, rows = {}, []
    for name in map(named, SETS):
        shares = [one["apart"][name] / one["cells"] for one in rooms]
        whole[name] = float(np.mean([share == 1 for share in shares]))
        rows.append({"angles": name, "rooms": whole[name], "least share of cells": min(shares)})
    show(f"Share of {len(rooms):,} rooms in which angles distinguish all cells", rows, ".1%")
    pairs = [named(s) for s in SETS if len(s) == 2 and whole[named(s)] == 1]
    print(f"Pairs that distinguish all cells in all rooms: {'; '.join(pairs) or 'none'}")

    needed, rows = {}, []
    for name in map(named, SEARCHED):
        results = [one["bumps"][name] for one in rooms]
        row, numbers = {"angles": name}, {}
        for kind in ("worst", "mean", "fixed"):
            values = np.array([one[kind] for one in results])
            numbers[kind] = {"median": float(np.median(values)), "most": float(values.max())}
            row |= {f"{kind}, {statistic}": x for statistic, x in numbers[kind].items()}
        row["proved"] = float(np.mean([all(one["proved"]) for one in results]))
        needed[name] = numbers | {"proved": row["proved"]}
        rows.append(row)
    show("Bumps until localized: median and largest over rooms", rows, ".3g", proved=".1%")
    return {
        "rooms": len(rooms),
        "all_cells_told_apart": whole,
        "pairs_for_all_rooms": pairs,
        "bumps": needed,
    }


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/switching_study", seed=0)
    parser.add_argument("--rooms", type=at_least(1), default=20, help="number of rooms")
    parser.add_argument("--workers", type=at_least(1), default=os.cpu_count(), help="processes")
    options = read_options(parser)

    path, began = options.out / f"rooms_{options.seed}.jsonl", time.perf_counter()
    lines = path.read_text().splitlines() if path.exists() else []
    done = {one["room"]: one for one in map(json.loads, lines)}
    missing = [room for room in range(options.rooms) if room not in done]
    with concurrent.futures.ProcessPoolExecutor(options.workers) as pool, path.open("a") as file:
        for one in pool.map(study_room, itertools.repeat(options.seed), missing):
            done[one["room"]] = one
            file.write(json.dumps(one) + "\n")
            file.flush()
    summary = report([done[room] for room in range(options.rooms)])
    (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    seconds = time.perf_counter() - began
    print(f"{len(missing):,} rooms in {seconds:.0f} s; results in {options.out}")


if __name__ == "__main__":
    main()
