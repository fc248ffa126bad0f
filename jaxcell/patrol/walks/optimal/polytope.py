import dataclasses
from typing import Any

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ....base.connected import check_connected
from ....optimize import Graph, shortest_tour
from ....optimize.validation import distribution
from .sinkhorn import scale_to_stationary


# Largest share of the time that a linear program may return for a flow of 0.
_NOTHING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class ChainPolytope:
    """The convex polytope of the chains on a graph, within which a search finds the best chain.

    A chain is the vector of the probabilities of its *moves*, the two directions of each edge and,
    if the patroller may stay, the loops. Moves that the stationary distribution rules out are
    omitted. The constraints are `A p = b` and `p >= 0`, so that all chains meet a prescribed
    distribution exactly.
    """

    vertices: int
    tails: Int[np.ndarray, "moves"]
    "The vertex at which each move begins."
    heads: Int[np.ndarray, "moves"]
    "The vertex at which each move ends."
    stationary: Float[np.ndarray, "vertices"] | None

    @classmethod
    def on(
        cls,
        graph: Graph,
        stationary: Any = None,
        *,
        stay: bool = False,
        possible: Bool[np.ndarray, "vertices vertices"] | None = None,
    ) -> "ChainPolytope":
        """Build the polytope of all chains that move along the edges of a connected graph.

        `stationary` is an array `[vertices]`, the share of the time to spend at each vertex; with
        `stay`, the patroller may wait at a vertex; moves that are not `possible` are left out.
        """
        moves = np.concatenate([graph.edges, graph.edges[:, ::-1]])
        if stay:
            loops = np.repeat(np.arange(graph.vertices, dtype=np.int32)[:, None], 2, axis=1)
            moves = np.concatenate([moves, loops])
        if possible is not None:
            moves = moves[possible[tuple(moves.T)]]
        check_connected(graph.vertices, moves)
        if stationary is not None:
            stationary = distribution("stationary", stationary, graph.vertices, "per vertex")
            moves = moves[_possible(moves, stationary, stay)]
            # A move that any chain makes is on a cycle, so connected vertices can reach each other.
            check_connected(
                graph.vertices, moves, "stationary: no chain with it visits all vertices, because"
            )
        tails, heads = moves.T
        return cls(graph.vertices, tails, heads, stationary)

    def matrix(
        self, moves: Float[np.ndarray, "*batch moves"]
    ) -> Float[np.ndarray, "*batch vertices vertices"]:
        """Build matrices, such as transition matrices, from one number per move."""
        matrix = np.zeros((*moves.shape[:-1], self.vertices, self.vertices))
        matrix[..., self.tails, self.heads] = moves
        return matrix

    def inside(self, weights: Float[np.ndarray, "moves"]) -> Float[np.ndarray, "moves"]:
        """Return a chain that uses all moves, with probabilities nearly in proportion to `weights`.

        With a stationary distribution, the rows and columns of the weights are scaled to meet it.
        """
        matrix = self.matrix(weights)
        if self.stationary is None:
            return (matrix / matrix.sum(axis=1, keepdims=True))[self.tails, self.heads]
        return scale_to_stationary(matrix, self.stationary)[self.tails, self.heads]

    def starts(
        self, count: int, robots: int, seed: int
    ) -> Float[np.ndarray, "starts robots moves"]:
        """Create the starts of a search: a short closed tour of all vertices, and random chains.

        The tour has a direction: from a start without direction, a gradient could not lead to a
        chain that goes round in one direction, because reversing a chain changes neither its speed
        nor its entropy. A robot leaves the tour with probability 1/11 or more. Each robot differs
        from the first, because equal robots would stay equal.
        """
        random = np.random.default_rng(seed)
        edges = np.unique(np.sort(np.stack([self.tails, self.heads], axis=1), axis=1), axis=0)
        edges = edges[edges[:, 0] != edges[:, 1]]
        tour = shortest_tour(Graph(edges, self.vertices), range(self.vertices))
        taken = np.zeros((self.vertices, self.vertices))
        np.add.at(taken, (tour, np.roll(tour, -1)), 1)
        weights = np.exp(random.normal(size=(count, robots, self.tails.size)))
        weights[0] = (taken[self.tails, self.heads] + 0.1) * np.where(
            np.arange(robots)[:, None] == 0, 1, weights[0] ** 0.3
        )
        return np.array([[self.inside(robot) for robot in start] for start in weights])

    def equalities(
        self,
    ) -> tuple[Float[np.ndarray, "equalities moves"], Float[np.ndarray, "equalities"]]:
        """Return `A` and `b`: row sums, then the equations of the stationary distribution."""
        move = np.arange(self.tails.size)
        rows = np.zeros((self.vertices, move.size))
        rows[self.tails, move] = 1
        if self.stationary is None:
            return rows, np.ones(self.vertices)
        flow = self.stationary[self.tails]
        columns = np.zeros_like(rows)
        columns[self.heads, move] = flow
        sides = np.append(np.ones(self.vertices), self.stationary)
        return np.concatenate([rows, columns]), sides

    def gap(self, moves: Float[np.ndarray, "moves"], gains: Float[np.ndarray, "moves"]) -> float:
        """Compute by how much `gains @ moves` is below its maximum over all chains.

        If `gains` is the gradient of a function, this is the Frank-Wolfe gap: 0 at a stationary
        point, and for a concave function a bound on its distance from the maximum. With any prices
        of the equalities, the best move from each vertex gives an upper bound. A linear program
        only finds good prices, so its tolerance does not matter.
        """
        if self.stationary is not None:
            sums, sides = self.equalities()
            unit = max(float(np.abs(gains).max()), np.finfo(float).tiny)
            program = scipy.optimize.linprog(-gains / unit, A_eq=sums, b_eq=sides)
            prices = -unit * program.eqlin.marginals[self.vertices :]
            gains = gains - prices @ sums[self.vertices :]
        best = np.full(self.vertices, -np.inf)
        np.maximum.at(best, self.tails, gains)
        return float((best[self.tails] - gains) @ moves)


def _possible(
    moves: Int[np.ndarray, "moves 2"], share: Float[np.ndarray, "vertices"], stay: bool
) -> Bool[np.ndarray, "moves"]:
    """Find the moves that are possible in a chain with the stationary distribution.

    One linear program finds a largest flow that does not exceed the shares of time. A move is
    possible if it has flow, or if the flow can change along a cycle that contains the move.
    """
    tails, heads = moves.T
    n, move = share.size, np.arange(len(moves))
    room = scipy.sparse.csr_array(
        (np.ones(2 * move.size), (np.append(tails, heads + n), np.tile(move, 2))),
        (2 * n, move.size),
    )
    flow = scipy.optimize.linprog(-np.ones(move.size), A_ub=room, b_ub=np.tile(share, 2)).x
    made = flow > _NOTHING
    change = scipy.sparse.csr_array(
        (
            np.ones(move.size + made.sum()),
            (np.append(tails, heads[made] + n), np.append(heads + n, tails[made])),
        ),
        (2 * n, 2 * n),
    )
    waiting = np.flatnonzero(np.bincount(tails, flow, n) < share - _NOTHING)
    if waiting.size:
        reached = scipy.sparse.csgraph.breadth_first_order(
            change, waiting[0], return_predecessors=False
        )
        crowd, ends = np.sort(reached[reached < n]), reached[reached >= n] - n
        listed = ", ".join(str(v) for v in crowd[:8]) + (", ..." if crowd.size > 8 else "")
        raise ValueError(
            f"stationary: vertices {listed} have {share[crowd].sum():.6g} of the time, but those "
            f"that follow have only {share[ends].sum():.6g}"
            + ("" if stay else "; a patroller that may stay could do it")
        )
    part = scipy.sparse.csgraph.connected_components(change, connection="strong")[1]
    return made | (part[tails] == part[heads + n])
