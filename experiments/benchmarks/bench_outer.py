"""Time Morse sets of Leslie's maps beside CMGDB.

    python experiments/benchmarks/bench_outer.py

Both programs bisect the box along each axis in turn, and keep the recurrent boxes. With intervals,
CMGDB maps boxes in C++, without rounding their ends outward. With corners, NumPy maps batches. The
numbers of boxes of all Morse sets, and of pairs of sets in the order, must agree. If CMGDB is
not installed, only jaxcell is timed.
"""

import contextlib
import importlib.util
import sys
import tempfile

import jax.numpy as jnp
import numpy as np
from rows import options, rows_of, write_rows
from timing import begin, table, take_turns

from jaxcell import dynamics
from jaxcell.base.process import no_output
from jaxcell.space import Box


GROWTH = [19.6, 23.68, 19.6]
UPPER = {2: [90.0, 70.0], 3: [90.0, 65.0, 45.0]}
# The bisections of CMGDB's own benchmarks.
DEPTH = {2: (20, 24), 3: (21, 24)}
# The sorted numbers of boxes of the sets, and the number of pairs of sets in the order.
Counts = tuple[list[int], int]


def leslie(x, p):
    first = sum(rate * y for rate, y in zip(GROWTH, x, strict=False)) * jnp.exp(-0.1 * sum(x))
    return jnp.stack([first, *(0.7 * x[:-1])])


def ours(images, axes: int) -> Counts:
    depth, most = DEPTH[axes]
    box = Box([-0.001] * axes, UPPER[axes], [1] * axes)
    sets = dynamics.morse_sets(images, box, depth=depth, check=most - depth)
    return sorted(sets.boxes.tolist()), int(sets.leads.sum())


def peer(kind: str, axes: int) -> Counts:
    import CMGDB

    def batch(points):
        first = points @ np.array(GROWTH[:axes]) * np.exp(-0.1 * points.sum(axis=1))
        return np.column_stack([first, *(0.7 * points[:, k] for k in range(axes - 1))])

    bounds = [-0.001] * axes, UPPER[axes]
    # CMGDB writes a file of statistics into the current folder.
    with no_output(), tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if kind == "intervals":
            graph = CMGDB.MorseGraphIntvalMap(*DEPTH[axes], *bounds, GROWTH[:axes], "/dev/null")
        else:
            model = CMGDB.Model(
                *DEPTH[axes], *bounds, lambda box: CMGDB.BoxMap(lambda x: batch(x[None])[0], box)
            )
            model.set_batch_map(lambda boxes: CMGDB.BoxMapBatch(batch, boxes))
            graph, _ = CMGDB.ComputeMorseGraph(model)
    sizes = sorted(len(graph.morse_set(k)) for k in range(graph.num_vertices()))
    return sizes, len(list(graph.edges_unreduced()))


def agree(results: dict[str, Counts]) -> None:
    counts = list(results.values())
    if any(other != counts[0] for other in counts):
        sys.exit(f"Morse sets differ: {results}")
    sizes, pairs = counts[0]
    print(f"\n{len(sizes)} Morse sets of {sizes} boxes, {pairs} pairs in their order\n")


def main() -> None:
    arguments = options(__doc__, repeats=5).parse_args()
    begin("jax", "numpy", "cmgdb")
    found = importlib.util.find_spec("CMGDB") is not None
    rows = []
    for kind, axes, images in (
        ("intervals", 2, dynamics.Intervals(leslie, mean_value=False)),
        ("corners", 2, dynamics.Corners(leslie)),
        ("corners", 3, dynamics.Corners(leslie)),
    ):
        programs = {"jaxcell": lambda images=images, axes=axes: ours(images, axes)}
        if found:
            programs["CMGDB"] = lambda kind=kind, axes=axes: peer(kind, axes)
        timings = take_turns(programs, arguments.repeats, agree)
        what = f"Morse sets of Leslie's map, {kind}"
        size = f"{axes} axes, {DEPTH[axes][0]} bisections"
        table(f"{what}, {size}", timings)
        rows += rows_of("outer", what, size, timings)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
