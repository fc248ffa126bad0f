"""Make the graphs of this folder: `python data/graphs/make_graphs.py [FOLDER]`.

The files have the same bytes on every machine. README.md describes each graph.
"""

import itertools
import json
import math
import random
import sys
from pathlib import Path

import numpy as np

from jaxcell.optimize import Graph


def eight() -> Graph:
    edges = [(1, 2), (2, 3), (3, 4), (1, 5), (2, 8), (2, 4), (6, 5), (5, 7), (7, 3), (8, 4)]
    edges += [(6, 7), (7, 8), (2, 7)]
    xy = [(1, 3), (2, 2.5), (3, 3), (3, 2), (1, 2), (1, 1), (2, 1.5), (3, 1)]
    return Graph(np.array(edges) - 1, xy=xy)


def line() -> Graph:
    return Graph([(v, v + 1) for v in range(19)], xy=[(v, 0) for v in range(20)])


def tree() -> Graph:
    """Make a random tree in which each vertex has at most three children."""
    draw = random.Random(4)
    below: list[list[int]] = [[] for _ in range(30)]
    edges, depth = [], [0]
    for v in range(1, 30):
        free = [u for u in range(v) if len(below[u]) < 3]
        # Of all methods, only random() draws the same numbers in every version of Python.
        above = free[math.floor(draw.random() * len(free))]
        below[above].append(v)
        edges.append((above, v))
        depth.append(depth[above] + 1)
    # Leaves have consecutive places, and other vertices are above the middle of their children.
    x: dict[int, float] = {}
    leaves = itertools.count()

    def place(v: int) -> None:
        for u in below[v]:
            place(u)
        ends = [x[u] for u in (below[v][:1] + below[v][-1:])]
        x[v] = sum(ends) / 2 if ends else float(next(leaves))

    place(0)
    return Graph(edges, xy=[(x[v], -1.5 * depth[v]) for v in range(30)])


def complete() -> Graph:
    """Make a complete graph on a circle.

    Places are rounded to millimetres, because the last digits of a cosine differ between machines.
    """
    angles = [math.pi / 2 + 2 * math.pi * v / 8 for v in range(8)]
    xy = [(round(2 * math.cos(a), 3), round(2 * math.sin(a), 3)) for a in angles]
    return Graph(list(itertools.combinations(range(8), 2)), xy=xy)


def random_50() -> Graph:
    """Make the 200 shortest edges between 50 random places in a square, at least 0.6 m apart."""
    draw = random.Random(0)
    places: list[tuple[int, int]] = []
    while len(places) < 50:
        # Whole millimetres have exact distances, so their order is the same on every machine.
        x, y = math.floor(draw.random() * 10000), math.floor(draw.random() * 10000)
        if all((x - a) ** 2 + (y - b) ** 2 >= 600**2 for a, b in places):
            places.append((x, y))

    def squared(pair: tuple[int, int]) -> int:
        return sum((a - b) ** 2 for a, b in zip(*(places[v] for v in pair), strict=True))

    pairs = sorted(itertools.combinations(range(50), 2), key=squared)
    return Graph(pairs[:200], xy=[(x / 1000, y / 1000) for x, y in places])


def main(folder: Path) -> None:
    graphs = {"line": line, "tree": tree, "complete": complete, "random": random_50, "eight": eight}
    for name, make in graphs.items():
        graph = make()
        names = [str(v + 1) for v in range(graph.vertices)]
        places = zip(names, graph.xy.tolist(), strict=True)
        nodes = [{"id": vertex, "x": x, "y": y} for vertex, (x, y) in places]
        edges = [{"source": names[i], "target": names[j]} for i, j in graph.edges.tolist()]
        members = ['"directed": false', '"multigraph": false', '"graph": {}']
        for key, parts in (("nodes", nodes), ("edges", edges)):
            lines = ",\n    ".join(map(json.dumps, parts))
            members.append(f'"{key}": [\n    {lines}\n  ]')
        (folder / f"{name}.json").write_text("{\n  " + ",\n  ".join(members) + "\n}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
