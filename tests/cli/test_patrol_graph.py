import ctypes
import functools
import importlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell.base.certificate import Certificate
from jaxcell.cli import main
from jaxcell.optimize import Graph, minimum_commute
from jaxcell.patrol import maximin_capture, random_walk
from jaxcell.patrol.files.graph_files import load_graph
from jaxcell.patrol.files.graph_saving import save_graph
from jaxcell.patrol.walks import MaximinCapture, walk_capture_probabilities, walk_hitting_times


GRAPHS = Path(__file__).parents[2] / "data" / "graphs"
EIGHT = GRAPHS / "eight.json"


def run(capsys, *args, file=EIGHT):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["patrol", "graph", str(file), *map(str, args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def transition(found):
    """The matrix that the summary tells."""
    names = [one["vertex"] for one in found["vertices"]]
    matrix = np.diag([one["stay"] for one in found["vertices"]])
    for edge in found["edges"]:
        i, j = (names.index(end) for end in edge["ends"])
        matrix[i, j], matrix[j, i] = edge["probabilities"]
    return matrix


def check_chain(found):
    """The transition matrix, after a look at what is said of it."""
    P = transition(found)
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=1e-9)
    pi = np.array([one["stationary"] for one in found["vertices"]])
    np.testing.assert_allclose(pi @ P, pi, atol=1e-9)
    if not pi.all():
        # In the long run it leaves out some, to which the times are infinite.
        return P
    n = len(P)
    fundamental = np.linalg.inv(np.eye(n) - P + pi)
    times = (np.diag(fundamental) - fundamental) / pi
    assert found["mean_commute_time"] == pytest.approx(2 * times.sum() / (n * (n - 1)))
    assert found["kemeny_constant"] == pytest.approx((times @ pi)[0])
    assert [one["mean_time_to"] for one in found["vertices"]] == pytest.approx(
        (times.sum(axis=0) / (n - 1)).tolist()
    )
    return P


def test_the_fastest_commute(capsys):
    status, found, _ = run(capsys)
    assert status == 0
    assert found["mean_commute_time"] == pytest.approx(18.626151, abs=1e-6)
    graph, _ = load_graph(EIGHT)
    P = check_chain(found)
    expected = random_walk(graph, minimum_commute(graph).weights).to_scipy().toarray()
    np.testing.assert_allclose(P, expected, atol=1e-9)
    assert found["gap"] <= 1e-8
    assert not found["game"]
    assert found["mixing_time"] >= 1


def test_emphasis_is_by_name(capsys):
    status, found, _ = run(capsys, "--emphasis", 2, 5, 8, "--share", 0.9)
    assert status == 0
    graph, _ = load_graph(EIGHT)
    weights = minimum_commute(graph, [1, 4, 7], 0.9).weights
    times = walk_hitting_times(graph, weights)
    assert found["mean_hitting_time"] == pytest.approx(times.sum() / 56)
    assert (found["emphasis"], found["share"]) == (["2", "5", "8"], 0.9)


def test_each_strategy_is_best_at_what_it_is_for(capsys):
    """Among the walks with the same measure, its own is the best."""
    found, said = {}, {}
    for name in ("commute", "toward", "mixing", "kemeny", "entropy"):
        args = ("--vertex", 3) if name == "toward" else ()
        status, found[name], said[name] = run(capsys, "--strategy", name, *args)
        assert status == 0
        check_chain(found[name])
    # Boyd, Diaconis and Xiao's published value.
    assert found["mixing"]["slem"] == pytest.approx(0.6810, abs=5e-5)
    # That toward a vertex leaves some out, which makes it fast.
    every = [name for name in found if name != "toward"]
    assert min(every, key=lambda name: found[name]["kemeny_constant"]) == "kemeny"
    assert max(found, key=lambda name: found[name]["entropy_rate_nats"]) == "entropy"
    assert min(every, key=lambda name: found[name]["mean_commute_time"]) in ("commute", "kemeny")
    assert "the walk is a local optimum" in said["kemeny"]
    assert "local optimum" not in said["entropy"]
    assert "in the long run the walk leaves out 4 of the vertices" in said["toward"]
    to_3 = {name: one["vertices"][2]["mean_time_to"] for name, one in found.items()}
    assert to_3["toward"] < min(to_3["commute"], to_3["entropy"], to_3["mixing"])


def test_the_game(capsys):
    status, found, _ = run(capsys, "--game", "--emphasis", 2, 5, 8)
    assert status == 0
    game = found["game"]
    # Alam 2018, Table 4.2; vertices that are equally far are in the order of their numbers.
    assert game["value"] == pytest.approx(7.689278)
    names = [one["strategy"] for one in game["strategies"]]
    assert names == [*(f"toward {v}" for v in range(1, 9)), "all vertices", "emphasis 2, 5, 8"]
    orders = {one["strategy"]: "".join(one["order"]) for one in game["strategies"]}
    assert orders["all vertices"] == "72538146"
    assert orders["emphasis 2, 5, 8"] == "82517463"
    assert sum(one["share"] for one in game["strategies"]) == pytest.approx(1)
    assert game["attacked"] in "12345678"
    without = run(capsys, "--game")[1]["game"]
    assert len(without["strategies"]) == 9


def test_the_solver_does_not_speak_on_standard_output(capfd, monkeypatch):
    module = importlib.import_module("jaxcell.patrol.walks.game")
    solve = module.stackelberg

    def speaks(*args, **options):
        os.write(1, b"the solver writes\n")
        ctypes.CDLL(None).printf(b"the solver prints\n")
        return solve(*args, **options)

    monkeypatch.setattr(module, "stackelberg", speaks)
    assert main(["patrol", "graph", str(EIGHT), "--game", "--json"]) == 0
    ctypes.CDLL(None).fflush(None)
    captured = capfd.readouterr()
    assert json.loads(captured.out)["game"]["value"] == pytest.approx(7.689278)
    assert "the solver writes\n" in captured.err
    assert "the solver prints\n" in captured.err


def test_tables_for_people(capsys):
    assert main(["patrol", "graph", str(EIGHT), "--game"]) == 0
    out = capsys.readouterr().out
    assert "18.6262 steps" in out
    assert re.search(r"│ +7 │ .* │ 19\.47 % +│ 4\.95\d* steps +│", out)
    assert re.search(r"what the patroller is paid +│ 7.68928 +│", out)
    assert main(["patrol", "graph", str(GRAPHS / "random.json")]) == 0
    assert "and 20 more" in capsys.readouterr().out


def test_a_periodic_walk_never_mixes(capsys):
    status, found, _ = run(capsys, file=GRAPHS / "line.json")
    assert (status, found["mixing_time"], found["slem"]) == (0, None, 1.0)
    assert main(["patrol", "graph", str(GRAPHS / "line.json")]) == 0
    assert re.search(
        r"steps until within 1/4 of the shares of time +│ never", capsys.readouterr().out
    )


def test_writes_its_results(capsys, tmp_path):
    out = tmp_path / "new" / "out"
    status, found, _ = run(capsys, "--game", "--robots", 2, "--out", out)
    assert status == 0
    assert {path.name for path in out.iterdir()} == {"patrol.nc", "patrol.rrd", "summary.json"}
    assert json.loads((out / "summary.json").read_text()) == found
    with xr.open_dataset(out / "patrol.nc") as dataset:
        np.testing.assert_array_equal(dataset.transition, transition(found))
        assert dataset.game_share.values.tolist() == [
            one["share"] for one in found["game"]["strategies"]
        ]
        assert json.loads(dataset.attrs["spec"])["strategy"] == "commute"


def test_other_formats_are_read(capsys, tmp_path):
    graph, names = load_graph(EIGHT)
    expected = run(capsys)[1]
    for suffix in (".graphml", ".edges"):
        save_graph(graph, tmp_path / f"eight{suffix}", names)
        found = run(capsys, file=tmp_path / f"eight{suffix}")[1]
        assert found["mean_commute_time"] == pytest.approx(expected["mean_commute_time"])


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--emphasis", 2, 9), "--emphasis: there is no vertex '9'; there are 1, 2, 3"),
        (("--emphasis", 2), "--emphasis: expected two or more vertices, got one"),
        (("--emphasis", 2, 5, 2), "--emphasis: vertex '2' comes twice"),
        (("--emphasis", 2, 5, "--share", 1.5), "share: expected 0 to 1, got 1.5"),
        (("--emphasis", 2, 5, "--strategy", "kemeny"), "--emphasis has no meaning for 'kemeny'"),
        (("--strategy", "toward"), "--vertex: 'toward' needs it"),
        (("--strategy", "toward", "--vertex", 0), "--vertex: there is no vertex '0'"),
        (("--strategy", "toward", "--vertex", 3, "--paths", 0), "paths: .* got 0"),
        (("--vertex", 3), "--vertex has no meaning for 'commute'"),
        (("--strategy", "capture"), "--attack-time: 'capture' needs it"),
        (
            ("--strategy", "capture", "--attack-time", 2),
            "--attack-time: 2 steps are over before .* from vertex '4' to '5', which takes 3",
        ),
        (("--attack-time", 3), "--attack-time has no meaning for 'commute'"),
        (
            ("--constraints", "c.json", "--strategy", "kemeny"),
            "--constraints has no meaning for 'kemeny'",
        ),
        (("--constraints", "none.json"), "none.json: there is no such file"),
        (("--robots", 0), "--robots: expected at least 1, got 0"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, args, message):
    status, found, error = run(capsys, *args)
    assert (status, found) == (2, None)
    assert error.count("\n") == 1
    assert re.search(f"^jaxcell patrol graph: .*{message}", error), error


def test_bad_files_are_one_line_and_status_2(capsys, tmp_path, monkeypatch):
    apart = Graph([[0, 1], [2, 3]], xy=np.zeros((4, 2)))
    save_graph(apart, tmp_path / "apart.json", ["a", "b", "c", "d"])
    (tmp_path / "empty.json").write_text("")
    for name, message in (
        ("apart.json", "no walk leads from vertex 'a' to 'c'; expected a connected graph"),
        ("empty.json", "not valid JSON, or cut short"),
        ("none.json", "there is no such file"),
    ):
        status, found, error = run(capsys, file=tmp_path / name)
        assert (status, found) == (2, None)
        assert re.fullmatch(rf"jaxcell patrol graph: .*{name}: {message}.*\n", error), error
    monkeypatch.setattr("jaxcell.study.patrol_graph.MAX_VERTICES", 7)
    status, _, error = run(capsys)
    assert status == 2
    assert "it has 8 vertices; the times between all pairs" in error


def test_no_answer_is_status_1(capsys, monkeypatch):
    def stalls(*args, **options):
        raise RuntimeError("the residual stayed above the tolerance")

    monkeypatch.setattr("jaxcell.optimize.minimum_commute", stalls)
    status, found, error = run(capsys)
    assert (status, found) == (1, None)
    assert error == "jaxcell patrol graph: the residual stayed above the tolerance\n"


def test_more_patrollers_come_sooner(capsys):
    found = run(capsys, "--robots", 2)[1]
    P = check_chain(found)
    pi = np.array([one["stationary"] for one in found["vertices"]])
    # Both at once are a chain on pairs of vertices; the first arrival is where either is.
    both, start = np.kron(P, P), np.kron(pi, pi)
    for vertex in range(8):
        off = np.arange(8) != vertex
        away = np.flatnonzero(np.kron(off, off))
        steps = np.linalg.solve(np.eye(away.size) - both[np.ix_(away, away)], np.ones(away.size))
        assert found["vertices"][vertex]["first_arrival"] == pytest.approx(start[away] @ steps)
    each = [one["first_arrival"] for one in found["vertices"]]
    assert found["mean_first_arrival"] == pytest.approx(np.mean(each))
    assert "mean_first_arrival" not in run(capsys)[1]


def test_large_graphs_say_that_times_are_of_one_patroller(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.patrol.walks.graph_patrol._MAX_ARRIVALS", 7)
    status, found, said = run(capsys, "--robots", 2)
    assert (status, "mean_first_arrival" in found) == (0, False)
    assert "on graphs of up to 7 vertices; other times are of one patroller" in said


def stubbed_capture(monkeypatch):
    """A search that gives each robot a random walk, and what it is asked for."""
    asked = []

    def search(graph, times, *, robots, **options):
        asked.append(times)
        walk = random_walk(graph, np.ones(len(graph.edges))).to_scipy().toarray()
        least = 1 - (1 - walk_capture_probabilities(graph, walk, times).min()) ** robots
        return MaximinCapture(np.stack([walk] * robots), float(least), 0, Certificate(1, 0.0, 1e-4))

    monkeypatch.setattr("jaxcell.patrol.maximin_capture", search)
    return asked


def test_attacks_of_different_lengths_on_two_patrollers(capsys, monkeypatch, tmp_path):
    asked = stubbed_capture(monkeypatch)
    times = [4, 4, 6, 3, 5, 7, 3, 4]
    file = tmp_path / "times.txt"
    file.write_text("".join(f"{v} {time}\n" for v, time in enumerate(times, 1)))
    two = run(capsys, "--strategy", "capture", "--attack-times", file, "--robots", 2)[1]
    np.testing.assert_array_equal(asked, [times])
    P = check_chain(two)
    for vertex, time in enumerate(times):
        late = np.arange(8) != vertex
        for _ in range(time - 1):
            late = np.where(np.arange(8) != vertex, P @ late, 0)
        captured = 1 - (P @ late).max() ** 2
        assert two["vertices"][vertex]["captured"] == pytest.approx(captured)
    assert two["value"] == pytest.approx(min(one["captured"] for one in two["vertices"]))
    assert two["goal"] == "least chance that 2 patrollers capture within its attack time"


def test_visits_are_those_of_the_file(capsys, tmp_path):
    file = tmp_path / "visits.txt"
    file.write_text(
        "".join(f"{v} {share}\n" for v, share in enumerate([1, 2, 1, 1, 1, 1, 2, 1], 1))
    )
    found = run(capsys, "--strategy", "entropy", "--visits", file)[1]
    check_chain(found)
    shares = [one["stationary"] for one in found["vertices"]]
    assert shares == pytest.approx([0.1, 0.2, 0.1, 0.1, 0.1, 0.1, 0.2, 0.1], abs=1e-8)


def test_stakes_are_those_of_the_file(capsys, tmp_path):
    file, out = tmp_path / "values.txt", tmp_path / "out"
    stakes = np.random.default_rng(0).integers(1, 9, (8, 4))
    file.write_text("".join(f"{v} {a} {b} {c} {d}\n" for v, (a, b, c, d) in enumerate(stakes, 1)))
    found = run(capsys, "--game", "--values", file, "--out", out)[1]["game"]
    with xr.open_dataset(out / "patrol.nc") as dataset:
        caught = 0.5 ** (dataset.game_rank.values - 1)
        goods, goods_adversary, reward, cost = stakes.T
        patroller = caught * reward + (1 - caught) * goods
        adversary = (1 - caught) * goods_adversary - caught * cost
        np.testing.assert_allclose(dataset.game_patroller_payoff, patroller)
        np.testing.assert_allclose(dataset.game_adversary_payoff, adversary)
    assert found["value"] <= stakes[:, [0, 2]].max()


@pytest.mark.parametrize(
    ("option", "text", "message"),
    [
        ("attack-times", "a 2\nb 2\nc 2.5", "line 3: expected a whole number more than 0, got 2.5"),
        ("visits", "a 1\nb 1", "there is no number for vertex 'c'"),
        ("values", "a 1 2\nb 1 2\nc 1", "line 3: expected 2 numbers, as before, got 1"),
        ("values", "a 1 2 3\nb 1 2 3\nc 1 2 3", "line 1: there is no vertex 'a 1 2'"),
    ],
)
def test_bad_numbers_for_vertices_are_one_line_and_status_2(
    capsys, tmp_path, option, text, message
):
    graph, file = tmp_path / "path.adjlist", tmp_path / "numbers.txt"
    graph.write_text("a b\nb c\n")
    file.write_text(text)
    strategy = {"attack-times": "capture", "visits": "kemeny", "values": "commute"}[option]
    game = ["--game"] if option == "values" else []
    args = ("--strategy", strategy, *game, f"--{option}", file)
    status, found, error = run(capsys, *args, file=graph)
    assert (status, found) == (2, None)
    assert error.count("\n") == 1
    assert f"{file}: {message}" in error


def constraints(folder, *several):
    file = folder / "constraints.json"
    file.write_text(json.dumps({"constraints": several}))
    return file


def test_constraints_are_met_and_verified(capsys, tmp_path):
    file = constraints(
        tmp_path,
        {"label": "corridor", "edges": [["1", "2"], ["5", "1"]], "most": 0.2},
        {"vertices": "all", "each": True, "least": 0.09},
        {"edges": [["6", "7"], ["7", 8]], "factors": [2, 3], "most": 0.48},
        {"same": [["2", "3"], ["2", "8"], ["3", "4"]]},
    )
    found = run(capsys, "--constraints", file, "--verify", "--out", tmp_path / "out")[1]
    check_chain(found)
    weight = {frozenset(edge["ends"]): edge["weight"] for edge in found["edges"]}
    assert weight[frozenset("12")] + weight[frozenset("15")] <= 0.2 + 1e-9
    assert min(one["stationary"] for one in found["vertices"]) >= 0.09 - 1e-9
    assert 2 * weight[frozenset("67")] + 3 * weight[frozenset("78")] <= 0.48 + 1e-9
    assert weight[frozenset("23")] == pytest.approx(weight[frozenset("28")], abs=1e-9)
    assert weight[frozenset("23")] == pytest.approx(weight[frozenset("34")], abs=1e-9)
    assert found["mean_commute_time"] > 18.626151
    told = {one["constraint"]: one for one in found["bounds"]["constraints"]}
    assert len(told) == 12
    assert told["edge 6-7, edge 7-8"]["active"]
    assert told["edge 6-7, edge 7-8"]["saves"] > 0
    assert not told["vertex 7"]["active"]
    assert told["vertex 7"]["saves"] == 0
    compared = {one["what"]: one for one in found["verified"]["comparisons"]}
    assert compared["least commute time, by cvxpy"]["count"] == 1
    assert compared["by how much constraints are broken"]["count"] == 12
    assert found["verified"]["agrees"]
    assert main(["patrol", "graph", str(EIGHT), "--constraints", str(file)]) == 0
    assert re.search(r"corridor .*│ 0\.2 +│ (yes|no)", capsys.readouterr().out)


def test_constraints_that_contradict_are_status_1(capsys, tmp_path):
    file = constraints(
        tmp_path,
        {"edges": "all", "each": True, "most": 0.5},
        {"label": "corridor", "edges": [["1", "2"], ["5", "1"]], "most": 0.1},
        {"vertices": ["1"], "least": 0.06},
    )
    status, found, error = run(capsys, "--constraints", file)
    assert (status, found) == (1, None)
    assert error.endswith("constraints: these contradict each other: corridor, vertex 1\n")


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        ({"edges": [["1", "8"]], "most": 0.1}, r"edges\[0\]: expected two vertices with an edge"),
        ({"vertices": ["9"], "most": 0.1}, r"vertices\[0\]: expected a vertex, got '9'"),
        (
            {"edges": [["1", "2"], ["2", "1"]], "most": 0.1},
            "edges: expected one or more, each once",
        ),
        ({"edges": [["1", "2"]]}, "expected least, most or both"),
        ({"edges": [["1", "2"]], "most": "low"}, "most: expected a finite number, got 'low'"),
        ({"edges": [["1", "2"]], "least": 0.2, "most": 0.1}, "most: expected at least 0.2, the"),
        ({"edges": "all", "vertices": "all"}, "expected either edges, vertices or same"),
        ({"edges": "all", "must": 0.1}, "must: expected one of label, edges, vertices"),
        ({"same": [["1", "2"]]}, "same: expected two or more edges"),
        ({"edges": "all", "each": 1, "most": 0.1}, "each: expected true or false, got 1"),
        ({"edges": [["1", "2"]], "factors": [1, 2], "most": 1}, "factors: expected numbers, 1 of"),
        ({"edges": [["1", "2"]], "factors": [0], "most": 1}, "expected finite coefficients, one"),
    ],
)
def test_bad_constraints_are_one_line_and_status_2(capsys, tmp_path, constraint, message):
    file = constraints(tmp_path, constraint)
    status, found, error = run(capsys, "--constraints", file)
    assert (status, found) == (2, None)
    assert error.count("\n") == 1
    assert re.search(rf"constraints\.json: .*{message}", error), error


def test_help_of_the_group(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["patrol", "--help"])
    assert stopped.value.code == 0
    assert "patrol graph" in capsys.readouterr().out


LINE = {
    "nodes": [{"id": name, "x": x, "y": 0} for x, name in enumerate("abcd")],
    "edges": [
        {"source": "a", "target": "b", "length": 2},
        {"source": "b", "target": "c", "length": 6},
        {"source": "c", "target": "d", "length": 2},
    ],
}


@pytest.fixture
def line(tmp_path):
    """Four places in a row, with a long way in the middle."""
    path = tmp_path / "line.json"
    path.write_text(json.dumps(LINE))
    return path


def test_seconds_and_news_and_what_others_do(capsys, line, tmp_path):
    out = tmp_path / "out"
    asked = ("--speed", 0.5, "--time-unit", 2, "--base", "b", "--robots", 2, "--baselines")
    status, found, _ = run(capsys, *asked, "--out", out, "--verify", file=line)
    assert status == 0
    # In a tree the time there and back is by the number of ways, and each takes twice its seconds.
    assert [one["duration"] for one in found["timed"]["edges"]] == [4, 12, 4]
    there = np.array([[4, 3], [12, 4], [4, 3]])
    # The shares of time on edges that are passed by k and n - k pairs are as sqrt(t k (n - k)).
    root = np.sqrt(there[:, 0] * there[:, 1])
    assert found["timed"]["mean_commute_time"] == pytest.approx(4 / 3 * root.sum() ** 2 / 4)
    rows = found["idleness"]["patrols"]
    assert [one["patrol"] for one in rows] == ["walk", "tour", "random", "reactive"]
    assert rows[1]["longest"] < rows[2]["longest"]
    assert found["news"]["base"] == "b"
    ages = [one["mean_age"] for one in found["news"]["vertices"]]
    assert ages[1] == pytest.approx(found["news"]["mean_since_passed"])
    assert ages[3] == max(ages)
    with xr.open_dataset(out / "patrol.nc") as data:
        assert float(data.timed_duration[1]) == 12
        assert "vertex" in data.news_told.dims
        np.testing.assert_allclose(data.news_told[-1], 1, atol=1e-8)


def test_sharing_against_dividing(capsys, line):
    status, found, said = run(capsys, "--robots", 2, "--division", "partition", file=line)
    assert status == 0
    shared, divided = found["division"]["divisions"]
    assert divided["mean_idleness"] == divided["worst_idleness"] == 2
    assert shared["worst_idleness"] > 2
    assert "robots walk differently" in said
    _, kept, _ = run(capsys, "--robots", 2, "--division", "shared", file=line)
    assert kept["division"] == found["division"]
    assert kept["worst_idleness"] == pytest.approx(shared["worst_idleness"])


def test_a_team_captures_in_seconds_what_its_law_says(capsys, line, monkeypatch):
    once = functools.partial(maximin_capture, starts=1)
    monkeypatch.setattr("jaxcell.patrol.maximin_capture", once)
    asked = ("--strategy", "capture", "--speed", 1, "--robots", 2, "--attack-time", 11)
    status, found, _ = run(capsys, *asked, "--division", "shared", file=line)
    assert status == 0
    assert "2 patrollers capture within 11 s" in found["goal"]
    # One at each end goes to and fro.
    assert found["value"] == pytest.approx(1, abs=1e-4)
    assert [one["least_capture"] for one in found["division"]["divisions"]][1] == 1


def test_a_charger(capsys, line):
    status, found, _ = run(capsys, "--charger", "b", "--every", 4, "--robots", 2, file=line)
    assert status == 0
    assert found["charged"]["mean_interval"] <= 4
    assert found["charged"]["charger"] == "b"


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--speed", 0), "--speed: expected more than 0"),
        (("--base", "z"), "base: there is no vertex 'z'"),
        (("--charger", "b"), "--every: expected with a charger, and only then"),
        (("--charger", "b", "--every", 3), "every: expected at least 4 steps"),
        (("--charger", "b", "--every", 9, "--speed", 1), "charger has no meaning with a speed"),
        (("--division", "shared"), "division has no meaning for one robot"),
        (("--division", "shared", "--robots", 3), "robots: expected 1 to 2 parts of 4 vertices"),
        (
            ("--strategy", "capture", "--attack-time", 9, "--speed", 1),
            "9 s are over before a patroller comes from vertex 'a' to 'd', which takes 10",
        ),
    ],
)
def test_teams_that_cannot_be_are_refused(capsys, line, args, message):
    status, found, error = run(capsys, *args, file=line)
    assert (status, found) == (2, None)
    assert message in error, error
    assert error.count("\n") <= 2


def test_steps_that_take_seconds_are_chosen_by_steps(capsys, line):
    _, found, said = run(capsys, "--strategy", "entropy", "--speed", 1, file=line)
    assert "the walk is chosen by steps; the times in seconds are those it then has" in said
    assert found["timed"]["mean_step"] > 2


def test_a_speed_needs_lengths(capsys, tmp_path):
    path = tmp_path / "line.adjlist"
    path.write_text("a b\nb c\n")
    status, found, error = run(capsys, "--speed", 1, file=path)
    assert (status, found) == (2, None)
    assert "line.adjlist have no lengths, and its vertices no positions" in error


def test_the_game_is_in_steps(capsys, line):
    status, found, said = run(capsys, "--game", "--speed", 1, file=line)
    assert status == 0
    assert found["game"]
    assert "the game counts steps, not seconds" in said
