"""Time subset construction: beside automata-lib for 2,000 cells, and alone on large maps.

Run `python experiments/benchmarks/bench_subset.py`; it takes about 15 s and 1 GB, and with `--full`
twice as much. jaxcell starts from NumPy arrays, and automata-lib from an `NFA` object. The time to
make this object has a row of its own.
"""

import math

import numpy as np
from automata.fa.dfa import DFA
from automata.fa.nfa import NFA
from rows import Row, options, rows_of, write_rows
from timing import begin, header, line, peak_bytes, table, take_turns

from jaxcell.automata import Filter, minimize, subset_construction
from jaxcell.bounce import bounce_map
from jaxcell.space import ENDPOINT, CellSpace


Graph = tuple[np.ndarray, np.ndarray]


def bounce(free: np.ndarray, directions: int, shift: int) -> Graph:
    """Compute the image and the observation of each cell; a bump turns by `shift` directions."""
    angle = math.tau * shift / directions
    simple = bounce_map(CellSpace.of_grid(free, directions), angle, motion=ENDPOINT)
    return np.asarray(simple.image), np.asarray(simple.bumped)


def room(width: int, height: int, *obstacles: tuple[int, int, int, int]) -> np.ndarray:
    free = np.ones((height, width), bool)
    for x0, y0, x1, y1 in obstacles:
        free[y0:y1, x0:x1] = False
    return free


def random_graph(cells: int) -> Graph:
    rng = np.random.default_rng(0)
    return rng.integers(0, cells, cells).astype(np.int32), rng.random(cells) < 0.5


def automaton_of(graph: Graph) -> NFA:
    image, observation = (array.tolist() for array in graph)
    edges = {z: {"01"[observation[z]]: {image[z]}} for z in range(len(image))}
    return NFA(
        states={"start", *edges},
        input_symbols={"0", "1"},
        transitions={"start": {"": set(edges)}, **edges},
        initial_state="start",
        final_states=set(edges),
    )


def compare(repeats: int) -> list[Row]:
    """Time both programs on 2,000 cells."""
    graphs = {
        "bounce map, 250 positions x 8": bounce(room(20, 15, (5, 4, 15, 9)), 8, 1),
        "random functional graph": random_graph(2000),
    }
    rows = []
    for name, graph in graphs.items():
        nfa = automaton_of(graph)
        states = len(subset_construction(*graph).transition)
        sets = DFA.from_nfa(nfa, retain_names=True, minify=False).states
        if states != sum(bool(cells) for cells in sets):
            raise SystemExit(f"{name}: {states} states here, {len(sets)} in automata-lib")
        timings = take_turns(
            {
                "jaxcell": lambda graph=graph: subset_construction(*graph),
                "automata-lib": lambda nfa=nfa: DFA.from_nfa(nfa, minify=False),
                "its NFA": lambda graph=graph: automaton_of(graph),
            },
            2 * repeats,
        )
        table(f"{name}, {states} states", timings)
        del timings["its NFA"]
        rows += rows_of("subset", f"localization filter, {name}", "2,000 cells", timings)
    return rows


def scale(repeats: int, full: bool) -> list[Row]:
    """Time the construction of filters of large maps, and their minimization."""
    small = room(32, 20, (8, 6, 14, 12), (20, 4, 26, 10))
    big = room(200, 125, (30, 20, 60, 45), (90, 70, 120, 95), (140, 20, 170, 45), (40, 85, 65, 115))
    graphs = {
        "lab room x 8, 45 deg": bounce(room(8, 4, (1, 1, 3, 3), (4, 0, 7, 3)), 8, 1),
        "32 x 20 room x 36, 90 deg": bounce(small, 36, 9),
        "200 x 125 room x 40, 90 deg": bounce(big, 40, 10),
    }
    if full:
        graphs["200 x 125 room x 40, 99 deg"] = bounce(big, 40, 11)
    # Sizes increase, so the peak so far is the peak of the last construction.
    peaks = {}
    for name, graph in graphs.items():
        subset_construction(*graph)
        peaks[name] = peak_bytes() / 1e6
    print()
    times = ("subsets, s", "peak, MB", "filter, s", "minimize, s", "minimal")
    header("map", "cells", "states", "members", *times)
    for name, graph in graphs.items():
        automaton = subset_construction(*graph)
        filter = Filter.of(automaton)
        timings = take_turns(
            {
                "subsets": lambda graph=graph: subset_construction(*graph),
                "filter": lambda made=automaton: Filter.of(made).color,
                "minimize": lambda filter=filter: minimize(filter),
            },
            repeats if graph[0].size < 100_000 else 2,
        )
        subsets, coloring, minimizing = (timing.median for timing in timings.values())
        sizes = graph[0].size, len(automaton.transition), automaton.members.size
        shown = f"{subsets:.4f}", f"{peaks[name]:.0f}", f"{coloring:.4f}", f"{minimizing:.4f}"
        line(name, *sizes, *shown, len(minimize(filter).transition))
        del automaton, filter
    size = f"{graph[0].size:,} cells"
    return [
        Row("subset", f"localization filter, {name}", size, subsets),
        Row("subset", f"minimization of that filter, {name}", size, minimizing),
    ]


def main() -> None:
    arguments = options(__doc__, repeats=10, full="an angle with more states").parse_args()
    begin("numpy", "automata-lib")
    rows = compare(arguments.repeats)
    write_rows(arguments.rows, rows + scale(arguments.repeats, arguments.full))


if __name__ == "__main__":
    main()
