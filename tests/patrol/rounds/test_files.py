"""Files of games, routes and timetables, and their errors."""

import copy
import csv
import json

import networkx as nx
import numpy as np
import pytest

from jaxcell.patrol import Graph
from jaxcell.patrol.files import load_ways
from jaxcell.patrol.rounds import (
    Game,
    Route,
    best_rounds,
    evaluate,
    is_game,
    load_game,
    load_routes,
    save_game,
    save_routes,
    save_timetable,
)


@pytest.fixture
def game():
    ways = nx.DiGraph()
    nx.add_cycle(ways, "abcd", length=6.0)
    ways.add_edge("c", "a", length=15.0)
    nx.set_node_attributes(ways, {name: {"x": i, "y": i % 2} for i, name in enumerate("abcd")})
    return Game.of(ways, [4.0, 9.0], robots=2, targets=["a", "d"], value=[2, 1], speed=2.0)


def test_game_and_routes_are_read_as_written(game, tmp_path):
    found = best_rounds(game)
    save_game(game, tmp_path / "game.json")
    save_routes(game, found.routes, tmp_path / "patrol.json")
    again = load_game(tmp_path / "game.json")
    assert (again.names, again.robots, again.unit) == (game.names, 2, "s")
    for name in ("ends", "times", "targets", "attack", "value", "xy"):
        np.testing.assert_array_equal(getattr(again, name), getattr(game, name))
    routes = load_routes(tmp_path / "patrol.json", again)
    assert evaluate(again, routes).exposure.tolist() == found.evaluation.exposure.tolist()


def test_timetable_lists_each_visit_of_the_night(game, tmp_path):
    routes = best_rounds(game).routes
    save_timetable(game, routes, tmp_path / "schedule.csv", 100.0)
    with (tmp_path / "schedule.csv").open() as file:
        rows = list(csv.DictReader(file))
    times = [float(row["time_s"]) for row in rows]
    assert times == sorted(times)
    assert times[-1] <= 100
    for number, route in enumerate(routes, 1):
        own = [row for row in rows if row["robot"] == str(number)]
        due = np.add.outer(np.arange(0, 200, route.period), route.arrive).ravel()
        np.testing.assert_allclose(
            [float(row["time_s"]) for row in own], due[due <= 100], atol=0.05
        )
        order = [game.names[v] for v in route.vertex]
        assert [row["vertex"] for row in own][: len(order)] == order
    assert rows[-1]["clock"].startswith("0:01:")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: g["targets"].clear(), "expected at least one way .* and one target"),
        (lambda g: g["targets"][0].update(vertex="x"), r"targets\[0\].vertex: .* got 'x'"),
        (lambda g: g["targets"][0].update(attack_time=0), r"targets\[0\].attack_time: .* than 0"),
        (lambda g: g["targets"].append(g["targets"][0]), "targets: expected each vertex once"),
        (lambda g: g["ways"][1].update(time="long"), r"ways\[1\].time: expected a finite number"),
        (lambda g: g["vertices"][1].update(name="a"), "vertices: .* all different"),
        (lambda g: g.update(robots=0), "robots: expected a whole number"),
        (lambda g: g.update(unit="h"), "unit: expected s or steps, got 'h'"),
        (lambda g: g.update(version=2), "version: expected at most 1"),
        (lambda g: g.update(robot=2), "robot: there is no such field; did you mean robots"),
        (lambda g: g["targets"][0].update(worth=2), r"targets\[0\].worth: .* known are vertex"),
        (lambda g: g["targets"][0].update(detection=0.5), r".*detection: .* visit always stops"),
        (lambda g: g.update(shares=[0.5]), "shares: .* `patrol.maximin_capture` with"),
        (lambda g: g.update(starts=["a"]), "starts: .* guards begin anywhere"),
        (lambda g: g.update(last_seen=2), "last_seen: .* blind or watcher, who remembers"),
        (lambda g: g["targets"][0].update(damage=[1, 2]), r".*damage: .* `value` is lost"),
        (lambda g: g.update(adversary="god"), "adversary: expected blind or watcher, got 'god'"),
    ],
)
def test_wrong_games_are_refused(game, tmp_path, change, message):
    save_game(game, tmp_path / "game.json")
    document = json.loads((tmp_path / "game.json").read_text())
    change(document)
    (tmp_path / "game.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match=rf"game.json: {message}"):
        load_game(tmp_path / "game.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.pop(), "robots: expected 2, as in the game, got 1"),
        (lambda r: r[0]["visits"][1].update(vertex="x"), "a vertex, got 'x'"),
        (lambda r: r[0]["visits"][1].update(vertex="d"), "there is no way from"),
        (lambda r: r[1]["visits"][1].update(time=9.5, until=9.0), "times decrease"),
        (lambda r: r[0].update(period=9.5), "from 'd' to 'a' takes 3 s, and the robot has 0.5"),
        (lambda r: r[0]["visits"].clear(), "expected a period above 0, and visits"),
    ],
)
def test_routes_that_no_robot_can_follow_are_refused(game, tmp_path, change, message):
    robots = [
        {"period": 12, "visits": [{"vertex": v, "time": 3 * i} for i, v in enumerate("abcd")]}
        for _ in range(2)
    ]
    path = tmp_path / "strategy.json"
    path.write_text(json.dumps({"robots": robots}))
    assert len(load_routes(path, game)) == 2
    change(robots)
    path.write_text(json.dumps({"robots": robots}))
    with pytest.raises(ValueError, match=rf"strategy.json: .*{message}"):
        load_routes(path, game)


def test_loops_and_longer_parallel_edges_are_left_out(tmp_path):
    ways = nx.MultiDiGraph()
    ways.add_edges_from([("a", "b", {"length": 9.0}), ("a", "b", {"length": np.float64(4)})])
    ways.add_edges_from([("b", "a", {"length": 5.0}), ("b", "b", {"length": 1.0})])
    nx.write_graphml(ways, tmp_path / "ways.graphml")
    for read in load_ways(ways), load_ways(tmp_path / "ways.graphml"):
        assert read.ends.tolist() == [[0, 1], [1, 0]]
        assert read.lengths.tolist() == [4.0, 5.0]
        assert [line.split()[:2] for line in read.omitted] == [["1", "loop"], ["1", "parallel"]]
    undirected = load_ways(nx.MultiGraph([(0, 1), (0, 1), (1, 2), (2, 2)]))
    assert undirected.ends.tolist() == [[0, 1], [1, 2], [1, 0], [2, 1]]
    assert len(undirected.omitted) == 2
    assert load_ways(Graph([[0, 1]])).lengths is None


def test_loops_and_parallel_ways_of_a_game_are_left_out(game, tmp_path):
    save_game(game, tmp_path / "game.json")
    document = json.loads((tmp_path / "game.json").read_text())
    first = document["ways"][0]
    document["ways"] += [{"from": "a", "to": "a", "time": 1}, first | {"time": 99}]
    (tmp_path / "game.json").write_text(json.dumps(document))
    read = load_game(tmp_path / "game.json")
    assert read.times.tolist() == game.times.tolist()
    assert read.omitted == (
        "1 loop is left out: a robot can wait at a vertex",
        "1 parallel edge is left out: the shortest of them is used",
    )


def test_file_cut_short_is_named(tmp_path):
    (tmp_path / "game.json").write_text('{"vertices": [')
    with pytest.raises(ValueError, match=r"game.json: not valid JSON, or cut short"):
        is_game(tmp_path / "game.json")


@pytest.mark.parametrize(
    ("vertex", "time", "period", "message"),
    [
        ([0, 2], [0.0, 3.0], 12.0, r"routes\[0\].visits\[0\]: there is no way"),
        ([0, 1], [0.0, 1.0], 12.0, "'a' to 'b' takes 3 s, and the robot has 1"),
        ([0, 1], [0.0, float("nan")], 12.0, "times decrease"),
        ([0, 1], [3.0, 0.0], 12.0, "times decrease"),
        ([0, 1], [0.0, 3.0], float("nan"), "a period above 0"),
        ([0, 9], [0.0, 3.0], 12.0, "expected vertices from 0 to 3"),
        ([], [], 12.0, "expected visits"),
    ],
)
def test_routes_from_python_are_checked(game, vertex, time, period, message):
    at = np.array(time)
    route = Route(np.array(vertex, int), at, at, period)
    with pytest.raises(ValueError, match=message):
        evaluate(game, [route])


def test_there_are_not_more_routes_than_robots(game):
    routes = best_rounds(game).routes
    with pytest.raises(ValueError, match="routes: expected 1 to 2, one per robot, got 4"):
        evaluate(game, routes * 2)


def test_python_takes_no_other_adversary(game):
    wrong = copy.copy(game)
    # The type checker of these tests would refuse it first.
    object.__setattr__(wrong, "adversary", "god")
    with pytest.raises(ValueError, match="adversary: expected blind or watcher, got 'god'"):
        wrong.__post_init__()


def test_graph_without_lengths_has_no_speed():
    with pytest.raises(ValueError, match="speed: edges have no lengths"):
        Game.of(Graph([[0, 1]]), 3.0, speed=1.0)
    with pytest.raises(ValueError, match="targets: there is no vertex '7'; there are 0, 1"):
        Game.of(Graph([[0, 1]]), 3.0, targets=["7"])
