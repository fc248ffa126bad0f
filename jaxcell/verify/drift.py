import networkx as nx
import numpy as np
import scipy.optimize
import scipy.sparse
from scipy.sparse import csgraph

from ..drift import CountedDrift, SeaDrift, SeaVoyage
from ..drift.results.layer_ends import LayerEnds
from ..drift.results.layered_result import LayeredResult
from .comparison import Comparison, solve_transient


_MAX_LAYERS = 3
# Sizes of a sparse direct solve, of graphs of Python objects, and of a linear program.
_MAX_TRANSIENT = 20_000
_MAX_NODES = 20_000
_MAX_PROGRAM = 5000


def compare_drift(drift: LayeredResult) -> list[Comparison]:
    """Compare persistent groups, the drifters that end in them, and voyages with other solvers."""
    compared = [one for layer in drift.layers[:_MAX_LAYERS] for one in _compare_layer(layer)]
    if not isinstance(drift, SeaDrift):
        return compared
    surface = drift.layers[0].behaviour.chain.to_scipy()
    cells = drift.deployment.cells
    steps = csgraph.dijkstra(surface, indices=cells, unweighted=True, min_only=True)
    # The least number of steps over all phases of a periodic current.
    steps = steps.reshape(-1, drift.layers[0].cells).min(axis=0)
    missed = [f"cell {z} is never visited" for z in np.flatnonzero(np.isinf(steps))]
    what = "cells visited from the deployment, by scipy"
    compared.append(Comparison.exact(what, missed, steps.size))
    return compared if drift.surest is None else [*compared, _compare_voyage(drift.surest)]


def compare_counted_drift(found: CountedDrift) -> list[Comparison]:
    """Compare shares with sums over single moves, and the route with Dijkstra of networkx."""
    counts = found.counts
    moves = counts.counts.tocoo()
    begin, end = moves.coords
    part, share = moves.data / counts.total[begin], found.share[0]
    for _ in range(round(found.hours[1] * 3600 / counts.lag)):
        share = np.bincount(end, part * share[begin], counts.cells)
    what = "shares of drifters at the first time, by sums over moves"
    compared = [Comparison.close(what, found.share[1], share, 1e-12)]
    if found.there is not None:
        going = 1 - counts.counts.diagonal() / counts.total
        graph, apart = nx.DiGraph(), begin != end
        length = -np.log(part[apart] / going[begin[apart]])
        graph.add_weighted_edges_from(zip(begin[apart], end[apart], length, strict=True))
        path = nx.dijkstra_path(graph, found.there[0][0], found.there[0][-1])
        hours = np.sum(counts.lag / 3600 / going[path[:-1]], keepdims=True)
        what = "time of the most likely route, by networkx"
        compared.append(Comparison.close(what, found.there[1][-1], hours, 1e-9, relative=True))
    return compared


def _compare_layer(layer: LayerEnds) -> list[Comparison]:
    behaviour, at = layer.behaviour, f" at {layer.depth:g} m"
    # For a periodic current, the chain has the cells at each phase.
    P, group = behaviour.chain.to_scipy(), np.asarray(behaviour.groups.group)
    transient = np.flatnonzero(group < 0)
    compared = [_compare_groups(P, group, f"persistent groups{at}, by networkx")]
    when = f"times until drifters are in a group or gone{at}, by a direct solve"
    where = f"shares that end in the first group{at}, by a direct solve"
    if not compared[0].agrees:
        # If the transient cells are wrong, a solve may have no solution.
        return compared
    if not 0 < transient.size <= _MAX_TRANSIENT:
        why = f"{transient.size:,} transient cells; it is done for 1 to {_MAX_TRANSIENT:,}"
        return [*compared, Comparison.omitted(when, why)]
    if not behaviour.absorption.certificate.converged:
        # If drifters stay almost forever in some cells, a direct solve is inaccurate.
        return [*compared, Comparison.omitted(when, "they are not certified")]
    times = solve_transient(P, transient, np.ones(transient.size))
    reported = np.asarray(behaviour.absorption.value)[transient]
    compared.append(Comparison.close(when, reported, times, 1e-6, relative=True))
    if layer.ends is not None and behaviour.groups.count:
        chances = solve_transient(P, transient, P[transient] @ (group == 0).astype(float))
        reported = np.asarray(layer.ends.value)[0][transient]
        compared.append(Comparison.close(where, reported, chances, 1e-7))
    return compared


def _compare_groups(P: scipy.sparse.csr_array, group: np.ndarray, what: str) -> Comparison:
    if len(group) > _MAX_NODES:
        return Comparison.omitted(what, f"more than {_MAX_NODES:,} cells")
    graph = nx.from_scipy_sparse_array(P, create_using=nx.DiGraph)
    leaves = set(np.flatnonzero(np.asarray(P.sum(axis=1)).ravel() < 1 - 1e-12).tolist())
    closed = {frozenset(one) for one in nx.attracting_components(graph) if not leaves & one}
    reported = {frozenset(np.flatnonzero(group == k).tolist()) for k in range(group.max() + 1)}
    wrong = [
        f"{len(cells)} cells from {min(cells)} on are {'no' if cells in reported else 'a'} group"
        for cells in sorted(reported ^ closed, key=min)
    ]
    return Comparison.exact(what, wrong, len(group))


def _compare_voyage(voyage: SeaVoyage) -> Comparison:
    what = "probability of arriving by the surest policy, by a linear program"
    sea, goal = voyage.sea, voyage.policy.goal
    if sea.drift.cells > _MAX_PROGRAM:
        return Comparison.omitted(what, f"more than {_MAX_PROGRAM:,} cells")
    actions = (sea.drift.to_scipy(), sea.ascent, sea.descent)
    raised = scipy.sparse.vstack([P - scipy.sparse.eye_array(sea.drift.cells) for P in actions])
    goal = np.tile(goal, sea.phases)
    bounds = np.column_stack([goal.astype(float), np.ones(goal.size)])
    rows = np.tile(~goal, len(actions))
    solved = scipy.optimize.linprog(
        np.ones(goal.size), raised.tocsr()[rows], np.zeros(rows.sum()), bounds=bounds
    )
    if solved.status != 0:
        return Comparison.omitted(what, f"the program has no solution: {solved.message}")
    return Comparison.close(what, voyage.policy.probability, solved.x[: sea.cells], 1e-6)
