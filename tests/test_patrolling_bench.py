"""The strategies of the bench of patrolling games have the values that the page states."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from experiments.patrolling_bench import __main__ as bench
from experiments.patrolling_bench.value import value
from jaxcell import patrol


PAGE = Path(__file__).parents[1] / "docs" / "pages" / "patrolling_bench.md"
STATED = {
    row[0]: row
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if (row := re.findall(r"(?<=\| )`?([^|`]*)`?(?= \|)", line)) and line.startswith("| `")
}
INSTANCES = {one["name"]: one for one in bench.instances()}


def test_each_game_is_in_the_table():
    games = {path.stem for path in (bench.HERE / "games").iterdir()}
    assert games == STATED.keys() == INSTANCES.keys()
    assert len(games) >= 30


@pytest.mark.parametrize("name", INSTANCES)
def test_values_are_those_of_the_page(name):
    found = bench.found(INSTANCES[name], bench.strategy_of(name))
    *_, known, stated, bound, _ = STATED[name]
    assert f"{found:.4f}" == stated
    assert bound == "optimal" or found < float(bound)
    if known and (fraction := re.match(r"(\d+)(?:/(\d+))? ", known)):
        assert found >= int(fraction[1]) / int(fraction[2] or 1) - 1e-6


@pytest.mark.parametrize("name", INSTANCES)
def test_values_are_those_of_jaxcell(name, tmp_path):
    game = patrol.rounds.load_game(bench.game_of(name))
    strategy = bench.read(bench.strategy_of(name))
    found = bench.found(INSTANCES[name], bench.strategy_of(name))
    if "walk" in strategy:
        graph, times, attack = bench.search.graph_of(game)
        states = len(strategy["walk"]["states"])
        matrix = np.zeros((states, states))
        for begin, end, chance in strategy["walk"]["moves"]:
            matrix[begin, end] = chance
        matrix /= matrix.sum(axis=1, keepdims=True)
        ours = patrol.walks.walk_capture_probabilities(graph, matrix, attack, times).min()
    else:
        risk = 0.0
        for one in strategy.get("drawn", [strategy | {"chance": 1.0}]):
            (tmp_path / "one.json").write_text(json.dumps(one))
            routes = patrol.rounds.load_routes(tmp_path / "one.json", game)
            risk = risk + one["chance"] * patrol.rounds.evaluate(game, routes).risk(game)
        ours = 1 - risk.max()
    assert found == pytest.approx(ours, abs=1e-6)


STEPS = [{"vertex": "0", "time": 0}, {"vertex": "1", "time": 1}]
TWO = {
    "robots": 1,
    "adversary": "blind",
    "vertices": [{"name": "0"}, {"name": "1"}],
    "ways": [{"from": "0", "to": "1", "time": 2}, {"from": "1", "to": "0", "time": 2}],
    "targets": [{"vertex": v, "attack_time": 3} for v in "01"],
}


@pytest.mark.parametrize(
    ("strategy", "message"),
    [
        ({"robots": [{"period": 4, "visits": STEPS}]}, "no time to go from 0 to 1"),
        ({"robots": []}, "expected 1, got 0"),
        ({"drawn": [{"chance": 0.5, "robots": []}]}, "do not add up to 1"),
        (
            {"walk": {"states": ["0", "1"], "moves": [[0, 1, 1], [1, 0, 1]]}},
            "one robot and a watch",
        ),
    ],
)
def test_strategies_that_cannot_be_followed_are_refused(strategy, message):
    with pytest.raises(ValueError, match=message):
        value(TWO, strategy)


def test_a_walk_misses_what_it_does_not_reach_in_time():
    moves = [[0, 1, 0.25], [0, 0, 0.75], [1, 0, 1.0]]
    walk = {"walk": {"states": ["0", "1"], "moves": moves}}
    targets = [{"vertex": v, "attack_time": 5} for v in "01"]
    # From 1 it is at 0 after 2 steps, and returns in the other 3 if it waits there at most once.
    game = TWO | {"adversary": "watcher", "targets": targets}
    assert value(game, walk) == pytest.approx(1 - 0.75**2)
