"""Search for the strategies of the bench by jaxcell, each with its bound."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxcell.patrol import Graph, maximin_capture, rounds
from jaxcell.patrol.walks import capture_bound

from .adam import best_walk


# Probabilities below this are left out of a walk; others have this number of digits.
LITTLE, DIGITS = 1e-6, 9


def search(path: Path, instance: dict[str, Any]) -> dict[str, Any]:
    """Search for a strategy: rounds, a mixture of them, or a walk if there is a memory."""
    game = rounds.load_game(path)
    began = time.perf_counter()
    by, memory = instance.get("by", "jaxcell"), instance.get("memory")
    if memory is None:
        strategy = _rounds(game)
    elif by == "Adam":
        graph, _, attack = graph_of(game)
        strategy = {"walk": _saved(game, best_walk(graph, int(attack[0]), memory))}
    else:
        strategy = {"walk": _walk(game, memory, instance.get("shares"))}
    return {"by": by, "seconds": round(time.perf_counter() - began, 1)} | strategy


def bound(path: Path, memory: int | None, tests: int) -> float:
    """Compute an upper bound on the value of all strategies; tests of cuts are for walks only."""
    game = rounds.load_game(path)
    found = float(rounds.bound(game).capture)
    if memory is not None:
        graph, times, attack = graph_of(game)
        given = {"travel_times": times, "stay": True, "tests": tests}
        found = min(found, capture_bound(graph, attack, **given))
    return found


def _rounds(game: rounds.Game) -> dict[str, Any]:
    routes = rounds.best_routes(game)
    if game.adversary == "blind":
        risk = rounds.evaluate(game, routes).risk(game).max()
        drawn = rounds.best_mixture(game)
        if drawn.risk < risk - 1e-9:
            pairs = zip(drawn.chance.tolist(), drawn.schedules, strict=True)
            return {"drawn": [{"chance": p, "robots": _robots(game, one)} for p, one in pairs]}
    return {"robots": _robots(game, routes)}


def _robots(game: rounds.Game, routes: tuple[rounds.Route, ...]) -> list[dict[str, Any]]:
    return [
        {
            "period": route.period,
            "visits": [
                {"vertex": game.names[vertex], "time": arrive}
                | ({"until": leave} if leave > arrive else {})
                for vertex, arrive, leave in zip(
                    route.vertex.tolist(), route.arrive.tolist(), route.leave.tolist(), strict=True
                )
            ],
        }
        for route in routes
    ]


def graph_of(game: rounds.Game) -> tuple[Graph, np.ndarray, np.ndarray]:
    """Return the edges, the directed times with waits of one step, and the attack times."""
    times = np.eye(len(game.names), dtype=int)
    times[tuple(game.ends.T)] = game.times
    edges = np.unique(np.sort(game.ends, axis=1), axis=0)
    return Graph(edges, len(game.names)), times, game.attack.astype(int)


def _walk(game: rounds.Game, memory: int, shares: list[float] | None) -> dict[str, Any]:
    graph, times, attack = graph_of(game)
    uniform = bool((game.times == 1).all()) and not np.ptp(attack)
    given = {"stay": True, "memory": memory, "stationary": shares, "throw": False}
    if uniform:
        found = maximin_capture(graph, int(attack[0]), **given)
    else:
        found = maximin_capture(graph, attack, travel_times=times, **given)
    return _saved(game, found.matrices[0])


def _saved(game: rounds.Game, matrix: np.ndarray) -> dict[str, Any]:
    """List the moves of a walk; rounding errors are added to the likeliest move of each state."""
    matrix = np.where(matrix > LITTLE, matrix, 0.0)
    matrix = np.round(matrix / matrix.sum(axis=1, keepdims=True), DIGITS)
    matrix[np.arange(len(matrix)), matrix.argmax(axis=1)] += 1 - matrix.sum(axis=1)
    matrix = np.round(matrix, DIGITS)
    begin, end = np.nonzero(matrix)
    moves = zip(begin.tolist(), end.tolist(), matrix[begin, end].tolist(), strict=True)
    return {"states": [*game.names] * (len(matrix) // len(game.names)), "moves": [*moves]}


def save(strategy: dict[str, Any], path: Path) -> None:
    """Write a strategy with a line for each of its visits or moves."""
    text = json.dumps(strategy)
    text = text.replace('"visits": [', '"visits": [\n').replace('"moves": [', '"moves": [\n')
    text = text.replace("}, {", "},\n{").replace("], [", "],\n[")
    path.write_text(text + "\n", encoding="utf-8")
