import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Float, Int

from ...base.connected import check_connected
from ...base.quantities import Result, quantity
from ...optimize import Graph, GraphLike
from .times import check_walks


# Steps per vertex of the search for equal parts, and the largest number of visits to vertices.
_STEPS, _WORK = 150, 1_500_000
# Initial temperature relative to the size of the largest part, and the cost of a single vertex.
_HEAT, _ALONE = 1.0, 1000


@dataclasses.dataclass(frozen=True, eq=False)
class Division(Result):
    """Robots that share a graph, compared with robots that each patrol a part of it."""

    title: ClassVar[str] = "Sharing a graph against dividing it"
    tables: ClassVar[Mapping[str, str]] = {"division": "divisions"}

    division: Annotated[list[str], quantity("division", "division", kind="coordinate")]
    mean_idleness: Annotated[
        Float[np.ndarray, "divisions"],
        quantity("division", "steps between visits, mean over vertices", "steps", kind="time"),
    ]
    worst_idleness: Annotated[
        Float[np.ndarray, "divisions"],
        quantity("division", "at the vertex with most of them", "steps", kind="time"),
    ]
    least_capture: Annotated[
        Float[np.ndarray, "divisions"] | None,
        quantity("division", "least chance of capture from the worst starts", "1", kind="share"),
    ]
    region: Annotated[
        Int[np.ndarray, "vertices"],
        quantity("vertex", "robot that has the vertex if it is divided", kind="index"),
    ]


def divide_graph(
    graph: GraphLike, parts: int, *, names: Sequence[str] | None = None
) -> Int[np.ndarray, "vertices"]:
    """Divide a graph into connected parts with nearly equal numbers of vertices.

    Parts grow from distant vertices: each time, the smallest part gets the nearest free vertex next
    to it. If sizes then differ by more than 1, simulated annealing moves vertices between parts.

    **Arguments:** a connected graph; the number of parts, at most half the number of vertices; and
    names of vertices, for errors. **Returns:** the part of each vertex. No part is a single vertex.

    A line of six vertices:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([(i, i + 1) for i in range(5)])
        >>> patrol.team.divide_graph(graph, 2).tolist()
        [0, 0, 0, 1, 1, 1]
    """
    check_connected(graph.vertices, graph.edges)
    if not 1 <= parts <= graph.vertices // 2:
        raise ValueError(
            f"expected 1 to {graph.vertices // 2} parts of {graph.vertices} vertices, got {parts}"
        )
    apart = scipy.sparse.csgraph.dijkstra(graph.matrix(graph.lengths), directed=False)
    # The first seed is an end of the longest path; each next one is farthest from all seeds.
    seeds = [int(apart.max(axis=1).argmax())]
    while len(seeds) < parts:
        seeds.append(int(apart[seeds].min(axis=0).argmax()))
    neighbours = graph.matrix(np.ones(len(graph.edges))).toarray() > 0
    part = np.full(graph.vertices, -1, np.int64)
    part[seeds] = np.arange(parts)
    while (part < 0).any():
        sizes = np.bincount(part[part >= 0], minlength=parts)
        for smallest in np.argsort(sizes, kind="stable"):
            free = np.flatnonzero((part < 0) & neighbours[part == smallest].any(axis=0))
            if free.size:
                part[free[apart[seeds[smallest], free].argmin()]] = smallest
                break
    part = _balanced(part, [np.flatnonzero(row).tolist() for row in neighbours], parts)
    alone = np.flatnonzero(np.bincount(part, minlength=parts) == 1)
    if alone.size:
        vertex = int(np.flatnonzero(part == alone[0])[0])
        raise ValueError(
            f"in every division into {parts} parts that was found, a part is a single vertex, as "
            f"{vertex if names is None else names[vertex]}; expected fewer"
        )
    return part


def _balanced(
    part: Int[np.ndarray, "vertices"], neighbours: list[list[int]], parts: int
) -> Int[np.ndarray, "vertices"]:
    """Move vertices between connected parts until sizes differ by at most 1, up to a step limit.

    A vertex moves to a neighbouring part. If its old part then falls into pieces, all pieces except
    one move too, so each part stays connected. The cost is the sum of the squares of the sizes,
    plus a large cost for a part of a single vertex.
    """
    random = np.random.default_rng(0)
    part_of, sizes = part.tolist(), np.bincount(part, minlength=parts).tolist()

    def cost(size: int) -> int:
        return size**2 + (_ALONE if size == 1 else 0)

    # The rise of the cost above the cost of the best division.
    best, total = part, 0
    steps = min(_STEPS * len(part_of), _WORK // (1 + len(part_of) // parts))
    for step in range(steps):
        if max(sizes) - min(sizes) <= 1:
            return np.array(part_of)
        vertex = int(random.integers(len(part_of)))
        old = part_of[vertex]
        others = [part_of[near] for near in neighbours[vertex] if part_of[near] != old]
        if not others or sizes[old] == 1:
            continue
        new = others[int(random.integers(len(others)))]
        pieces = _pieces_without(vertex, part_of, neighbours)
        stays = pieces[int(random.integers(len(pieces)))]
        rise = (
            cost(len(stays))
            + cost(sizes[new] + sizes[old] - len(stays))
            - cost(sizes[old])
            - cost(sizes[new])
        )
        heat = _HEAT * (1 - step / steps) * max(sizes)
        if rise > 0 and random.random() >= np.exp(-rise / heat):
            continue
        for moved in [vertex, *(each for piece in pieces if piece is not stays for each in piece)]:
            part_of[moved] = new
        sizes[new] += sizes[old] - len(stays)
        sizes[old] = len(stays)
        total += rise
        if total < 0:
            best, total = np.array(part_of), 0
    return best


def _pieces_without(vertex: int, part: list[int], neighbours: list[list[int]]) -> list[list[int]]:
    """Return the connected pieces of the part of `vertex`, after this vertex is removed."""
    pieces, reached = [], {vertex}
    for first in neighbours[vertex]:
        if part[first] != part[vertex] or first in reached:
            continue
        piece = [first]
        reached.add(first)
        for here in piece:
            for near in neighbours[here]:
                if part[near] == part[vertex] and near not in reached:
                    reached.add(near)
                    piece.append(near)
        pieces.append(piece)
    return pieces


def part_of_graph(graph: GraphLike, vertices: Int[np.ndarray, "part"]) -> Graph:
    """Return the subgraph of given vertices, numbered from 0 in the given order.

    The last three vertices of a line of four:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([(i, i + 1) for i in range(3)])
        >>> patrol.team.part_of_graph(line, np.array([1, 2, 3])).edges.tolist()
        [[0, 1], [1, 2]]
    """
    vertices = _checked_part(graph, vertices)
    number = np.full(graph.vertices, -1)
    number[vertices] = np.arange(vertices.size)
    ends = number[graph.edges]
    inside = (ends >= 0).all(axis=1)
    if not inside.any():
        raise ValueError("vertices: no edge joins two of them; expected a part with edges")
    places = None if graph.xy is None else graph.xy[vertices]
    ways = None if graph.ways is None else graph.ways[inside]
    return Graph(ends[inside], vertices.size, places, ways)


def walk_in_part(
    graph: GraphLike, vertices: Int[np.ndarray, "part"], matrix: Float[np.ndarray, "inside inside"]
) -> Float[np.ndarray, "states states"]:
    """Extend a walk in a part of a graph to all vertices, by shortest paths to the part.

    `matrix` is the transition matrix between the vertices of the part; the result is the transition
    matrix between all vertices. For a robot with memory, states are pairs of a state of the memory
    and a vertex, where the vertex varies fastest.

    A walk that alternates between two vertices at one end of a line of four:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([(i, i + 1) for i in range(3)])
        >>> walk = np.array([[0, 1.0], [1, 0]])
        >>> patrol.team.walk_in_part(line, np.array([0, 1]), walk).argmax(axis=1)
        array([1, 0, 1, 2])
    """
    vertices, matrix = _checked_part(graph, vertices), np.asarray(matrix, np.float64)
    memory = max(1, len(matrix) // vertices.size)
    if matrix.shape != (memory * vertices.size,) * 2:
        raise ValueError(
            f"matrix: expected an array [{vertices.size}, {vertices.size}] for the vertices of the "
            f"part, got {list(matrix.shape)}"
        )
    lengths = graph.matrix(np.maximum(graph.lengths, np.finfo(np.float64).tiny))
    _, before, _ = scipy.sparse.csgraph.dijkstra(
        lengths, directed=False, indices=vertices, min_only=True, return_predecessors=True
    )
    starts = graph.vertices * np.arange(memory)[:, None]
    whole = np.zeros((memory * graph.vertices,) * 2)
    outside = np.setdiff1d(np.arange(graph.vertices), vertices)
    apart = outside[before[outside] < 0]
    if apart.size:
        raise ValueError(f"graph: no path leads from vertex {apart[0]} to the part")
    whole[starts + outside, starts + before[outside]] = 1
    inside = (starts + vertices).ravel()
    whole[np.ix_(inside, inside)] = matrix
    check_walks(graph, whole[None], memory=True, name="matrix")
    return whole


def _checked_part(graph: Graph, vertices: Any) -> Int[np.ndarray, "part"]:
    """Return vertices of a graph as an array, after a check that they exist and are distinct."""
    part = np.asarray(vertices)
    if part.ndim != 1 or part.size == 0 or not np.issubdtype(part.dtype, np.integer):
        raise ValueError(f"vertices: expected one or more vertices of the graph, got {vertices!r}")
    wrong = part[(part < 0) | (part >= graph.vertices)]
    if wrong.size:
        raise ValueError(
            f"vertices: expected numbers from 0 to {graph.vertices - 1}, got {wrong[0]}"
        )
    if np.unique(part).size < part.size:
        raise ValueError(f"vertices: expected different vertices, got {part.tolist()}")
    return part
