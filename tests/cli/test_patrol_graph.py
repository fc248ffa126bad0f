import ctypes
import importlib
import json
import os
import re
from pathlib import Path

import pytest
from helpers import run

from jaxcell.cli import main
from jaxcell.patrol import load_graph
from jaxcell.patrol.walks import load_constraints


GRAPHS = Path(__file__).parents[2] / "data" / "graphs"
EIGHT = GRAPHS / "eight.json"


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


def test_a_periodic_walk_never_mixes(capsys):
    status, answer, _ = run(capsys, "patrol graph", GRAPHS / "line.json")
    assert (status, answer["mixing_time"], answer["slem"]) == (0, None, 1.0)
    assert main(["patrol", "graph", str(GRAPHS / "line.json")]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"steps until within 1/4 of the shares of time +│ never", shown)


def test_large_graphs_say_that_times_are_of_one_patroller(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.patrol.walks.graph_patrol.MAX_ARRIVALS", 7)
    status, answer, said = run(capsys, "patrol graph", EIGHT, "--robots", 2)
    assert (status, "mean_first_arrival" in answer) == (0, False)
    assert "on graphs of up to 7 vertices; other times are of one patroller" in said


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
    _, answer, _ = run(capsys, "patrol graph", EIGHT, "--constraints", file, "--verify")
    weight = {frozenset(edge["ends"]): edge["weight"] for edge in answer["edges"]}
    assert weight[frozenset("12")] + weight[frozenset("15")] <= 0.2 + 1e-9
    assert min(one["stationary"] for one in answer["vertices"]) >= 0.09 - 1e-9
    assert 2 * weight[frozenset("67")] + 3 * weight[frozenset("78")] <= 0.48 + 1e-9
    assert weight[frozenset("23")] == pytest.approx(weight[frozenset("28")], abs=1e-9)
    assert weight[frozenset("23")] == pytest.approx(weight[frozenset("34")], abs=1e-9)
    assert answer["mean_commute_time"] > 18.626151
    bounds = {bound["constraint"]: bound for bound in answer["bounds"]["constraints"]}
    assert len(bounds) == 12
    assert bounds["edge 6-7, edge 7-8"]["active"]
    assert bounds["edge 6-7, edge 7-8"]["saves"] > 0
    assert not bounds["vertex 7"]["active"]
    assert bounds["vertex 7"]["saves"] == 0
    compared = {one["what"]: one for one in answer["verified"]["comparisons"]}
    assert compared["least commute time, by cvxpy"]["count"] == 1
    assert compared["violation of constraints"]["count"] == 12
    assert answer["verified"]["agrees"]
    assert main(["patrol", "graph", str(EIGHT), "--constraints", str(file)]) == 0
    assert re.search(r"corridor .*│ 0\.2 +│ (yes|no)", capsys.readouterr().out)


def test_constraints_that_contradict_are_status_1(capsys, tmp_path):
    file = constraints(
        tmp_path,
        {"edges": "all", "each": True, "most": 0.5},
        {"label": "corridor", "edges": [["1", "2"], ["5", "1"]], "most": 0.1},
        {"vertices": ["1"], "least": 0.06},
    )
    status, answer, error = run(capsys, "patrol graph", EIGHT, "--constraints", file)
    assert (status, answer) == (1, None)
    assert error.endswith("constraints: these contradict each other: corridor, vertex 1\n")


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        ({"edges": [["1", "8"]], "most": 0.1}, r"edges\[0\]: expected two vertices with an edge"),
        ({"vertices": ["9"], "most": 0.1}, r"vertices\[0\]: expected a vertex, got '9'"),
        ({"edges": [["1", "2"], ["2", "1"]], "most": 0.1}, "edges: expected one or more, each o"),
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
def test_bad_constraints_are_refused(tmp_path, constraint, message):
    with pytest.raises(ValueError, match=rf"constraints\.json: .*{message}"):
        load_constraints(constraints(tmp_path, constraint), *load_graph(EIGHT))


@pytest.fixture
def line(tmp_path):
    """Four places in a row, with a long way in the middle."""
    nodes = [{"id": name, "x": x, "y": 0} for x, name in enumerate("abcd")]
    lengths = {"ab": 2, "bc": 6, "cd": 2}
    edges = [{"source": a, "target": b, "length": length} for (a, b), length in lengths.items()]
    path = tmp_path / "line.json"
    path.write_text(json.dumps({"nodes": nodes, "edges": edges}))
    return path


@pytest.mark.parametrize(
    ("options", "part", "remark"),
    [
        (
            ("--strategy", "entropy", "--speed", 1),
            "timed",
            "the walk is chosen by steps; the times in seconds are those it then has",
        ),
        (("--game", "--speed", 1), "game", "the game counts steps, not seconds"),
        (
            ("--strategy", "capture", "--attack-time", 5, "--memory-states", 2),
            "walks_with_memory",
            "shares and entropy above are those of the walk without memory",
        ),
    ],
)
def test_parts_of_a_result_are_remarked(capsys, line, options, part, remark):
    status, answer, said = run(capsys, "patrol graph", line, *options)
    assert status == 0
    assert answer[part]
    assert remark in said
