"""The walks of robots on a graph, by the strategies of the study `PatrolGraph`."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ... import optimize, patrol
from ...base.certificate import Certificate
from ...mapping import Chain
from ..study import Say, about
from .patrol_graph import PatrolGraph


@dataclasses.dataclass(frozen=True, kw_only=True)
class Walk:
    """The walks of robots that a strategy chose; the fields are those of `GraphPatrol`."""

    chain: Chain
    toward: int | None = None
    team: Float[np.ndarray, "robots vertices vertices"] | None = None
    goal: str | None = None
    value: float | None = None
    certificate: Certificate | None = None
    local: bool = False
    bounds: "patrol.walks.MetConstraints | None" = None

    def matrices(self, robots: int) -> Float[np.ndarray, "robots vertices vertices"]:
        """Return the transition matrix of each robot."""
        return (
            np.stack([self.chain.to_scipy().toarray()] * robots) if self.team is None else self.team
        )


def find_walks(
    study: PatrolGraph, graph: optimize.Graph, names: Sequence[str], say: Say
) -> tuple[Walk, "patrol.team.Division | None"]:
    """Find the walks of all robots. With `division`, compare sharing and dividing the graph."""
    robots = study.robots
    if study.division is None:
        return _find_walk(study, graph, names, robots), None
    with about("robots"):
        region = patrol.team.divide_graph(graph, robots, names=names)
    divided = _divided(study, graph, names, region, say)
    shared = None
    try:
        study.check_reach(graph, names, 1)
    except ValueError:
        if study.division == "shared":
            raise
    else:
        say(f"seeking walks of {robots} robots on the whole graph")
        shared = _find_walk(study, graph, names, robots)
    caught = study.strategy == "capture"
    chosen = divided if shared is None or study.division == "partition" else shared
    return chosen, _compared(shared, divided, region, robots, caught)


def _divided(
    study: PatrolGraph,
    graph: optimize.Graph,
    names: Sequence[str],
    region: Int[np.ndarray, "vertices"],
    say: Say,
) -> Walk:
    """Find walks of robots that each stay in a part of the graph; the value is the least of all."""
    parts, matrices = [], []
    for robot in range(study.robots):
        say(f"seeking a walk on part {robot + 1} of {study.robots}")
        inside = np.flatnonzero(region == robot)
        part = patrol.team.part_of_graph(graph, inside)
        called = [names[v] for v in inside.tolist()]
        study.check_reach(part, called, 1)
        parts.append(_find_walk(study, part, called, 1))
        within = parts[-1].chain.to_scipy().toarray()
        matrices.append(patrol.team.walk_in_part(graph, inside, within))
    worst = min(parts, key=lambda part: part.value or 0.0)
    chain = Chain.from_scipy(scipy.sparse.csr_array(matrices[0]))
    return dataclasses.replace(worst, chain=chain, team=np.stack(matrices))


def _compared(
    shared: Walk | None,
    divided: Walk,
    region: Int[np.ndarray, "vertices"],
    robots: int,
    caught: bool,
) -> "patrol.team.Division":
    """Compare robots that divide the graph with robots that share it, if `shared` is given."""
    rows = []
    for walk in (shared, divided):
        visits = np.full(region.size, np.nan)
        if walk is not None:
            shares = patrol.team.long_run(walk.matrices(robots))
            visits = patrol.team.steps_between_visits(shares)
        value = np.nan if walk is None or walk.value is None else walk.value
        rows.append((visits.mean(), visits.max(), value))
    mean, worst, value = np.array(rows).T
    return patrol.team.Division(
        ["shared", "partition"], mean, worst, value if caught else None, region
    )


def _find_walk(
    study: PatrolGraph, graph: optimize.Graph, names: Sequence[str], robots: int
) -> Walk:
    """Find the walk of the strategy for a graph, or for a part of it."""
    if study.strategy == "toward":
        (vertex,) = study.vertices(names, "vertex", str(study.vertex))
        return Walk(chain=patrol.toward(graph, vertex, study.paths), toward=vertex)
    if study.strategy == "commute":
        return _commute(study, graph, names)
    if study.strategy == "capture":
        return _capture(study, graph, names, robots)
    # With free shares of time, the best walks leave some vertices out.
    shares, visits = np.full(graph.vertices, 1 / graph.vertices), None
    if study.visits is not None:
        visits = patrol.files.load_values(study.visits, names)
        shares = visits = visits / visits.sum()
    if study.strategy == "mixing":
        mixing = optimize.fastest_mixing(graph, shares)
        return Walk(chain=mixing.chain, certificate=mixing.certificate)
    if study.strategy == "entropy":
        best = patrol.walks.maximum_entropy_rate(graph, visits, stay=visits is not None)
        return Walk(chain=best.chain, certificate=best.certificate)
    if study.strategy == "kemeny":
        best = patrol.walks.minimum_kemeny(graph, shares, stay=True, throw=False)
        return Walk(chain=best.chain, certificate=best.certificate, local=True)
    best = patrol.walks.maximum_return_time_entropy(graph, shares, stay=True, throw=False)
    return Walk(
        chain=best.chain,
        goal="return-time entropy, in nats",
        value=best.value,
        certificate=best.certificate,
        local=True,
    )


def _commute(study: PatrolGraph, graph: optimize.Graph, names: Sequence[str]) -> Walk:
    emphasis = study.vertices(names, "emphasis", *study.emphasis) or None
    rules = study.rules(graph, names)
    best = optimize.minimum_commute(
        graph, emphasis, study.share, durations=study.times(graph), constraints=rules
    )
    bounds = None
    if best.prices is not None:
        bounds = patrol.walks.MetConstraints(rules, best.weights, best.prices)
    chain = patrol.random_walk(graph, best.weights)
    return Walk(chain=chain, certificate=best.certificate, bounds=bounds)


def _capture(study: PatrolGraph, graph: optimize.Graph, names: Sequence[str], robots: int) -> Walk:
    best = patrol.maximin_capture(
        graph,
        study.attack(names),
        travel_times=study.times(graph),
        robots=robots,
        throw=False,
    )
    who = "one patroller captures" if robots == 1 else f"{robots} patrollers capture"
    within = f"{study.attack_time} {'steps' if study.speed is None else 's'}"
    if study.attack_time is None:
        within = "its attack time"
    return Walk(
        chain=best.chains[0],
        team=best.matrices if robots > 1 else None,
        goal=f"least chance that {who} within {within}",
        value=best.value,
        certificate=best.certificate,
        local=True,
    )
