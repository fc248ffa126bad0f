"""Seek the map of section 4.5 of Alam 2018, which has 188 cells and 523 pairs of neighbours.

    python -m experiments.chapter_4.same_counts

The source gives these numbers (n = 188, p = 1046 directed edges) and a picture. The script divides
each bundled map into cells of many sizes, and counts the pairs of neighbours where 188 cells are
free. It writes `same_counts.csv`; it takes two minutes.
"""

import numpy as np

from jaxcell.patrol import cell_graph
from jaxcell.space import CellSpace, Workspace

from ..shared.data import MAPS
from ..shared.options import experiment_parser, read_options
from ..shared.report import emit, say, tracked


CELLS, PAIRS, SIZES = 188, 523, 900
NAMES = ("lab_a", "lab_b", "room_200x125", "complex", "cafe", "arena", "slanted", "depot")
OTHERS = ("harbour.json", "office.yaml", "maze.txt")


def pairs_by_size(room: Workspace) -> list[int]:
    """Return the number of pairs of neighbours for each cell size with 188 free cells."""
    wide, high = np.ptp(np.array(room.boundary), axis=0)
    free = np.sqrt(wide * high / CELLS)
    found = []
    for cell in np.append(np.linspace(0.5, 1.2, SIZES) * free, 1.0).tolist():
        try:
            cells = CellSpace.of(room, cell, 8)
        except ValueError:
            # No cell of this size is free.
            continue
        if cells.positions == CELLS:
            found.append(len(cell_graph(cells).edges))
    return found


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/same_counts")
    options = read_options(parser)
    files = [*(f"{name}.json" for name in NAMES), *OTHERS]
    rows = []
    for file in tracked(files, "maps"):
        found = pairs_by_size(Workspace.load(MAPS / file))
        pairs = ", ".join(map(str, sorted(set(found))))
        rows.append({"map": file, "sizes with 188 cells": len(found), "pairs": pairs})
    emit(f"{CELLS} cells in {SIZES + 1} sizes per map", rows, options.out / "same_counts.csv")
    hit = any(str(PAIRS) in row["pairs"].split(", ") for row in rows)
    say(f"A bundled map with {PAIRS} pairs {'was' if hit else 'was not'} found.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
