import dataclasses
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ..files import name_in_results
from .options import OutputOptions, say_memory, starting
from .terminal import note, status, stdout_on_stderr, table


if TYPE_CHECKING:
    from ..certificate import Certificate
    from ..mapping import Chain
    from ..optimize import Graph
    from ..patrol.walks.game import StrategyGame
    from ..patrol.walks.measures import Measures


# The matrices of all pairs, and the eigenvalues, take minutes.
_MOST_VERTICES = 3000
_MOST_LISTED = 30


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolGraph(OutputOptions):
    """Find a random walk with which to patrol a graph, and play against an adversary."""

    file: tyro.conf.Positional[Path]
    """Graph file: node-link .json, .graphml, or a list of vertices and edges .edges or .txt."""
    strategy: Literal[
        "commute", "toward", "mixing", "kemeny", "entropy", "return-time", "capture"
    ] = "commute"
    """What the walk is for: a short time there and back (commute), --vertex (toward), forgetting
    its start (mixing), a short time to any vertex (kemeny), steps that are hard to guess (entropy),
    returns that are (return-time), or capture within --attack-time (capture). For mixing, kemeny
    and return-time it spends the same time at all vertices, and may wait."""
    emphasis: tuple[str, ...] = ()
    """Two or more vertices to visit more often, for "commute" and the game."""
    share: float = 0.8
    """Least share of steps on the shortest closed tour through them."""
    vertex: str | None = None
    """The vertex that "toward" is toward."""
    paths: int = 3
    """Shortest paths from each vertex that lead there, for "toward" and the game."""
    attack_time: int | None = None
    """Steps that an attack takes, for "capture", which is by one patroller."""
    robots: int = 1
    """How many patrollers walk, each by itself."""
    game: bool = False
    """Also mix the walks toward each vertex and "commute", against an adversary who knows it."""
    seed: int = 0
    """Seed of the walk that is recorded."""

    def run(self) -> int:
        with starting():
            from ..patrol.walks.game import strategy_game
            from ..patrol.walks.graph_files import load_graph
            from ..patrol.walks.measures import measure
        graph, names = load_graph(self.file)
        self._check(graph, names)
        began = time.perf_counter()
        game = None
        try:
            with stdout_on_stderr():
                with status(f"seeking a walk on {graph.vertices:,} vertices"):
                    found = self._walk(graph, names)
                    measures = measure(found.chain)
                if self.game:
                    with status("mixing strategies"):
                        emphasis = self._emphasis(names) or None
                        game = strategy_game(graph, emphasis, self.share, paths=self.paths)
        except RuntimeError as error:
            note(f"jaxcell patrol graph: {error}")
            return 1
        seconds = time.perf_counter() - began
        spec = self._spec(graph)
        summary = {
            **spec,
            **describe(graph, names, found, measures),
            "game": None if game is None else describe_game(game, names),
            "seconds": round(seconds, 3),
        }
        if self.out is not None:
            self._write(self.out, graph, names, measures, game, spec)
        return self.finish(
            summary,
            lambda: show(summary),
            lambda verify: [
                *verify.compare_walk(measures),
                *([] if game is None else verify.compare_game(game)),
            ],
        )

    def _check(self, graph: "Graph", names: Sequence[str]) -> None:
        """Raises `ValueError` in the words of the file and the options."""
        import numpy as np
        from scipy.sparse.csgraph import shortest_path

        from .. import estimates, memory

        if graph.vertices > _MOST_VERTICES:
            raise ValueError(
                f"{self.file}: it has {graph.vertices:,} vertices; the times between all pairs are "
                f"computed for at most {_MOST_VERTICES:,}"
            )
        weighted = self.strategy == "commute" or self.game
        needed = estimates.walk(graph.vertices, len(graph.edges), weighted)
        doing = f"a walk on {graph.vertices:,} vertices and {len(graph.edges):,} edges"
        memory.check(needed, doing, "expected a smaller graph, or another --strategy")
        say_memory(needed, doing)
        hops = shortest_path(graph.matrix(np.ones(len(graph.edges))), unweighted=True)
        apart = np.flatnonzero(np.isinf(hops[0]))
        if apart.size:
            raise ValueError(
                f"{self.file}: no walk leads from vertex {names[0]!r} to {names[apart[0]]!r}; "
                "expected a connected graph"
            )
        if self.robots < 1:
            raise ValueError(f"--robots: expected at least 1, got {self.robots}")
        if self.emphasis and not (self.strategy == "commute" or self.game):
            raise ValueError(f"--emphasis has no meaning for {self.strategy!r} without --game")
        if len(self._emphasis(names)) == 1:
            raise ValueError("--emphasis: expected two or more vertices, got one")
        for option, strategy in (("vertex", "toward"), ("attack_time", "capture")):
            given, wanted = getattr(self, option) is not None, self.strategy == strategy
            flag = "--" + option.replace("_", "-")
            if given and not wanted:
                raise ValueError(f"{flag} has no meaning for {self.strategy!r}")
            if wanted and not given:
                raise ValueError(f"{strategy!r} needs {flag}")
        # To a vertex and back it takes two steps.
        np.fill_diagonal(hops, 2)
        if self.attack_time is not None and self.attack_time < hops.max():
            start, end = (names[v] for v in np.unravel_index(hops.argmax(), hops.shape))
            raise ValueError(
                f"--attack-time: {self.attack_time} steps are over before a patroller comes from "
                f"vertex {start!r} to {end!r}, which takes {hops.max():g}"
            )

    def _emphasis(self, names: Sequence[str]) -> list[int]:
        found = [_number(names, name, "--emphasis") for name in self.emphasis]
        for i, name in enumerate(self.emphasis):
            if name in self.emphasis[:i]:
                raise ValueError(f"--emphasis: vertex {name!r} comes twice")
        return found

    def _walk(self, graph: "Graph", names: Sequence[str]) -> "_Walk":
        """What the strategy finds."""
        import numpy as np
        from scipy.sparse import csr_array

        from ..mapping import Chain
        from ..optimize import minimum_commute
        from ..optimize.mixing import fastest_mixing
        from ..patrol import random_walk
        from ..patrol.walks.capture import maximin_capture
        from ..patrol.walks.entropy import maximum_entropy_rate, maximum_return_time_entropy
        from ..patrol.walks.kemeny import minimum_kemeny
        from ..patrol.walks.paths import toward

        best: Any
        if self.strategy == "commute":
            best = minimum_commute(graph, self._emphasis(names) or None, self.share)
            return _Walk(random_walk(graph, best.weights), best.certificate)
        if self.strategy == "toward":
            assert self.vertex is not None
            vertex = _number(names, self.vertex, "--vertex")
            return _Walk(random_walk(graph, toward(graph, vertex, self.paths)))
        if self.strategy == "capture":
            assert self.attack_time is not None
            best = maximin_capture(graph, self.attack_time)
            chain = Chain.from_scipy(csr_array(best.matrices[0]))
            goal = f"least chance that one patroller captures within {self.attack_time} steps"
            return _Walk(chain, best.certificate, goal, best.value)
        # Without shares that are told, the best walks leave some vertices out.
        even = np.full(graph.vertices, 1 / graph.vertices)
        if self.strategy == "mixing":
            best = fastest_mixing(graph, even)
        elif self.strategy == "kemeny":
            best = minimum_kemeny(graph, even, stay=True)
        elif self.strategy == "entropy":
            best = maximum_entropy_rate(graph)
        else:
            best = maximum_return_time_entropy(graph, even, stay=True)
            return _Walk(best.chain, best.certificate, "return-time entropy, in nats", best.value)
        return _Walk(best.chain, best.certificate)

    def _spec(self, graph: "Graph") -> dict[str, Any]:
        """What determines the result."""
        spec: dict[str, Any] = {"graph": name_in_results(self.file), "strategy": self.strategy}
        if self.emphasis:
            spec |= {"emphasis": list(self.emphasis), "share": self.share}
        if self.vertex is not None:
            spec["vertex"] = self.vertex
        if self.strategy == "toward" or self.game:
            spec["paths"] = self.paths
        if self.attack_time is not None:
            spec["attack_time"] = self.attack_time
        return {**spec, "robots": self.robots, "seed": self.seed}

    def _write(
        self,
        out: Path,
        graph: "Graph",
        names: Sequence[str],
        measures: "Measures",
        game: "StrategyGame | None",
        spec: dict[str, Any],
    ) -> None:
        from .. import record

        with status(f"writing {out}"):
            out.mkdir(parents=True, exist_ok=True)
            options: dict[str, Any] = {"names": names, "game": game, "spec": spec}
            dataset = record.patrol_graph_dataset(graph, measures, **options)
            record.save_dataset(dataset, out / "patrol.nc")
            record.log_patrol_graph(
                out / "patrol.rrd", graph, measures, robots=self.robots, seed=self.seed, **options
            )


@dataclasses.dataclass(frozen=True)
class _Walk:
    """A patroller's chain, and how good it is, as far as that is known."""

    chain: "Chain"
    certificate: "Certificate | None" = None
    goal: str | None = None
    "What was made large, if it is none of the measures of all walks."
    value: float | None = None


def describe(
    graph: "Graph", names: Sequence[str], walk: "_Walk", measures: "Measures"
) -> dict[str, Any]:
    """The numbers that a person or a script wants of a walk."""
    to = measures.hitting_times.sum(axis=0) / (graph.vertices - 1)
    P = measures.transition
    return {
        "mean_commute_time": measures.mean_commute_time,
        "mean_hitting_time": measures.mean_hitting_time,
        "kemeny_constant": measures.kemeny_constant,
        "entropy_rate_nats": measures.entropy_rate,
        "slem": measures.slem,
        "mixing_time": None if math.isinf(measures.mixing_time) else measures.mixing_time,
        "goal": walk.goal,
        "value": walk.value,
        "certificate": None if walk.certificate is None else dataclasses.asdict(walk.certificate),
        "vertices": [
            {
                "name": name,
                "stationary": float(measures.stationary[v]),
                "mean_hitting_time": float(to[v]),
                "stay": float(P[v, v]),
            }
            for v, name in enumerate(names)
        ],
        "edges": [
            {"ends": [names[i], names[j]], "probabilities": [float(P[i, j]), float(P[j, i])]}
            for i, j in graph.edges.tolist()
        ],
    }


def describe_game(game: "StrategyGame", names: Sequence[str]) -> dict[str, Any]:
    """The numbers that a person or a script wants of a game."""
    best = game.commitment
    return {
        "strategies": [
            {"strategy": strategy, "share": share, "order": [names[v] for v in order]}
            for strategy, share, order in zip(
                game.labels(names), best.weights.tolist(), game.order.tolist(), strict=True
            )
        ],
        "value": best.value,
        "attacked": names[int(best.answer[0])],
        "adversary_value": float(best.follower_value[0]),
        "certificate": dataclasses.asdict(best.certificate),
    }


def show(summary: dict[str, Any]) -> None:
    """Prints a walk, and a game, for people."""
    certificate, mixing = summary["certificate"], summary["mixing_time"]
    vertices, edges = summary["vertices"], summary["edges"]
    table(
        f"{summary['graph']}: {summary['strategy']}",
        ("quantity", "value"),
        [
            ("graph", f"{len(vertices):,} vertices, {len(edges):,} edges"),
            *([(summary["goal"], f"{summary['value']:.6g}")] if summary["goal"] else []),
            ("mean commute time", f"{summary['mean_commute_time']:.6g} steps"),
            ("mean hitting time", f"{summary['mean_hitting_time']:.6g} steps"),
            ("Kemeny constant", f"{summary['kemeny_constant']:.6g} steps"),
            ("entropy rate", f"{summary['entropy_rate_nats']:.6g} nats a step"),
            ("second eigenvalue modulus", f"{summary['slem']:.6g}"),
            ("mixing time", "never: it is periodic" if mixing is None else f"{mixing:g} steps"),
            ("certificate", "none" if certificate is None else _within(certificate)),
            ("seconds", f"{summary['seconds']:g}"),
        ],
    )
    rows = [
        (one["name"], f"{one['stationary']:.6f}", f"{one['mean_hitting_time']:.2f}")
        for one in vertices[:_MOST_LISTED]
    ]
    more = len(vertices) > _MOST_LISTED
    title = f"The first {_MOST_LISTED} of {len(vertices):,} vertices" if more else "The vertices"
    table(title, ("vertex", "share of time", "mean steps to it"), rows)
    game = summary["game"]
    if game is not None:
        table(
            "The game",
            ("quantity", "value"),
            [
                ("what the patroller is paid", f"{game['value']:.6g}"),
                ("what the adversary is paid", f"{game['adversary_value']:.6g}"),
                ("the vertex that it attacks", game["attacked"]),
            ],
        )
        used = [one for one in game["strategies"] if one["share"] > 0]
        table(
            "The best mixture",
            ("strategy", "share"),
            [(one["strategy"], f"{one['share']:.6f}") for one in used],
        )


def _within(certificate: dict[str, Any]) -> str:
    return f"{certificate['residual']:.1e}, where {certificate['tolerance']:.0e} is good"


def _number(names: Sequence[str], name: str, option: str) -> int:
    if name not in names:
        listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        raise ValueError(f"{option}: there is no vertex {name!r}; there are {listed}")
    return names.index(name)
