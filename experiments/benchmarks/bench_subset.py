"""Times subset construction: side by side with automata-lib at N = 2,000, and alone on large maps.

Run `python experiments/benchmarks/bench_subset.py`; it takes about 15 s and 1 GB, and with `--full`
twice as much. Times are medians of several warm runs in one process. Both programs start from what
they take: NumPy arrays here, an `NFA` object there, whose making has a column of its own.
"""

import resource

import numpy as np
from automata.fa.dfa import DFA
from automata.fa.nfa import NFA
from rows import Row, options, rows_of, write_rows
from timing import begin, take_turns

from jaxcell.automata import Filter, minimize, subset_construction


Graph = tuple[np.ndarray, np.ndarray]


def bounce(free: np.ndarray, directions: int, shift: int) -> Graph:
    """Image and observation of a robot that goes on where the next cell is free and turns else."""
    height, width = free.shape
    number = np.full((height + 2, width + 2), -1)
    number[1:-1, 1:-1][free] = np.arange(free.sum())
    y, x = np.nonzero(free)
    image, observation = [], []
    for direction in range(directions):
        angle = 2 * np.pi * direction / directions
        dx, dy = np.floor(0.5 + np.round([np.cos(angle), np.sin(angle)], 9)).astype(int)
        target = number[y + dy + 1, x + dx + 1]
        turned = (direction + shift) % directions * x.size + np.arange(x.size)
        image.append(np.where(target >= 0, direction * x.size + target, turned))
        observation.append(target < 0)
    return np.concatenate(image).astype(np.int32), np.concatenate(observation)


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


def peak() -> float:
    """Peak memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def compare(repeats: int) -> list[Row]:
    graphs = {
        "bounce map, 250 positions x 8": bounce(room(20, 15, (5, 4, 15, 9)), 8, 1),
        "random functional graph": random_graph(2000),
    }
    print(
        f"{'N = 2,000':30} {'states':>7} {'jaxcell ms':>11}"
        f" {'automata-lib ms':>16} {'its NFA ms':>11} {'ratio':>6}"
    )
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
        ours, theirs, building = (timing.median for timing in timings.values())
        print(
            f"{name:30} {states:7} {1e3 * ours:11.2f}"
            f" {1e3 * theirs:16.1f} {1e3 * building:11.1f} {theirs / ours:6.1f}"
        )
        del timings["its NFA"]
        rows += rows_of("subset", f"localization filter, {name}", "2,000 cells", timings)
    return rows


def scale(repeats: int, full: bool) -> list[Row]:
    small = room(32, 20, (8, 6, 14, 12), (20, 4, 26, 10))
    big = room(200, 125, (30, 20, 60, 45), (90, 70, 120, 95), (140, 20, 170, 45), (40, 85, 65, 115))
    graphs = {
        "lab room x 8, 45 deg": bounce(room(8, 4, (1, 1, 3, 3), (4, 0, 7, 3)), 8, 1),
        "32 x 20 room x 36, 90 deg": bounce(small, 36, 9),
        "200 x 125 room x 40, 90 deg": bounce(big, 40, 10),
    }
    if full:
        graphs["200 x 125 room x 40, 99 deg"] = bounce(big, 40, 11)
    # From the smallest to the largest, so that the peak so far is that of the last construction.
    peaks = {}
    for name, graph in graphs.items():
        subset_construction(*graph)
        peaks[name] = peak()
    print(
        f"\n{'':28} {'N':>7} {'states':>7} {'members':>10} {'subsets s':>10} {'peak MB':>8}"
        f" {'filter s':>9} {'minimize s':>11} {'minimal':>8}"
    )
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
        print(
            f"{name:28} {graph[0].size:7} {len(automaton.transition):7} {automaton.members.size:10}"
            f" {subsets:10.4f} {peaks[name]:8.0f} {coloring:9.4f} {minimizing:11.4f}"
            f" {len(minimize(filter).transition):8}"
        )
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
