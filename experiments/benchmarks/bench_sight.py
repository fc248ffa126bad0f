"""Time the visibility between cells beside shapely.

Run `python experiments/benchmarks/bench_sight.py`; it takes about half a minute. `--full` adds a
map of 10,000 cells with slanted walls.

For each pair of a viewer and a cell in range, shapely tests in batches if the prepared environment
covers the convex hull of the viewer's centre and each convex part of the cell. The pairs in range
are computed before, without timing. The environment has a margin of 1e-9 of a cell, because the
exact predicates of shapely would exclude cells that touch a slanted wall. The script stops if the
results differ.
"""

import numpy as np
import shapely
from rows import Row, options, rows_of, write_rows
from timing import begin, header, line, take_turns

from experiments.shared.data import MAPS
from jaxcell.space import CellSpace, Workspace
from jaxcell.space.sight import visible_cells, visible_centres


REACH = 6


def large(slanted: bool) -> CellSpace:
    """Make about 10,000 free cells among rectangles of whole cells, or among slanted polygons."""
    random = np.random.default_rng(0)
    obstacles = []
    for _ in range(200):
        corner, size = random.integers(0, 105, 2), random.integers(1, 5, 2)
        if slanted:
            turn = np.sort(random.uniform(0, 2 * np.pi, 5))
            ring = random.uniform(0.5, 2.5) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            obstacles.append(shapely.MultiPoint(corner + ring).convex_hull)
        else:
            obstacles.append(shapely.box(*corner, *(corner + size)))
    side = 104 if slanted else 108
    inside = [o for o in obstacles if o.bounds[0] < side and o.bounds[1] < side and o.bounds[2] > 0]
    return CellSpace.of(Workspace(shapely.box(0, 0, side, side), inside), 1.0, 1)


class Peer:
    """Visibility by shapely, with its pairs in range."""

    def __init__(self, cells: CellSpace, reach: float) -> None:
        self.cells = cells
        x, y, _ = cells.centre(np.arange(cells.positions))
        centre = np.stack([x, y], axis=1)
        half = cells.cell / 2
        squares = shapely.box(x - half, y - half, x + half, y + half)
        margin = 1e-9 * cells.cell
        self.free = cells.workspace.environment.buffer(margin, join_style="mitre")
        shapely.prepare(self.free)
        whole = shapely.covers(self.free, squares)
        parts = np.where(whole, squares, shapely.intersection(cells.workspace.environment, squares))
        parts[~whole] = shapely.constrained_delaunay_triangles(parts[~whole])
        part, of = shapely.get_parts(parts, return_index=True)
        ring = [shapely.get_coordinates(p)[[0, 1, 2, -2]] for p in part]
        viewer, near = shapely.STRtree(part).query(
            shapely.points(centre), predicate="dwithin", distance=reach
        )
        self.corners = np.concatenate([centre[viewer][:, None], np.array(ring)[near]], axis=1)
        far = np.hypot(*np.moveaxis(self.corners - self.corners[:, :1], -1, 0)).max(axis=1)
        beyond = far > reach + margin
        # Cells with a part out of range are not visible.
        out = np.zeros((cells.positions, cells.positions), bool)
        out[viewer[beyond], of[near][beyond]] = True
        keep = ~out[viewer, of[near]]
        self.viewer, self.target = viewer[keep], of[near][keep]
        self.corners, self.count = self.corners[keep], np.bincount(of)

    def visible(self) -> np.ndarray:
        hulls = shapely.convex_hull(shapely.multipoints(self.corners))
        covered = shapely.covers(self.free, hulls)
        seen = np.zeros((self.cells.positions, self.cells.positions), np.int32)
        np.add.at(seen, (self.viewer[covered], self.target[covered]), 1)
        return seen == self.count


def cells_of(name: str) -> CellSpace:
    workspace = Workspace.load(MAPS / name)
    return CellSpace.of(workspace, workspace.cell, 1)


def side_by_side(name: str, cells: CellSpace, repeats: int) -> list[Row]:
    """Time the visibility of one map."""
    reach = REACH * cells.cell
    peer = Peer(cells, reach)
    seen = 0

    def check(results: dict[str, np.ndarray]) -> None:
        nonlocal seen
        found, expected = results["jaxcell"], results["shapely"]
        if (found != expected).any():
            raise SystemExit(f"{name}: {np.count_nonzero(found != expected)} pairs differ")
        seen = np.count_nonzero(found)

    timings = take_turns(
        {
            "jaxcell": lambda: visible_cells(cells, reach),
            "shapely": peer.visible,
            "jaxcell, centres": lambda: visible_centres(cells, reach),
        },
        repeats,
        check,
        patience_s=5,
    )
    ratio = timings["shapely"].median / timings["jaxcell"].median
    least = (f"{timing.least:.3f}" for timing in timings.values())
    line(name, f"{cells.positions:,}", f"{seen:,}", *least, f"{ratio:.0f}")
    del timings["jaxcell, centres"]
    what = f"cells wholly in sight of each, {name}"
    return rows_of("sight", what, f"{cells.positions:,} cells", timings)


def main() -> None:
    arguments = options(__doc__, repeats=5, full="10,000 cells among slanted walls").parse_args()
    begin("numpy", "shapely")
    print(f"Fully visible cells, range {REACH} cells; least seconds, ratio of medians\n")
    header("map", "cells", "visible pairs", "jaxcell", "shapely", "jaxcell, centres", "ratio")
    rows = []
    for name in ("depot.json", "harbour.json", "arena.json", "office.yaml"):
        rows += side_by_side(name, cells_of(name), arguments.repeats)
    rows += side_by_side("10^4, on the grid", large(slanted=False), 3)
    if arguments.full:
        rows += side_by_side("10^4, slanted", large(slanted=True), 3)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
