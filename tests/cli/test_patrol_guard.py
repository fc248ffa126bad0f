"""Commands of guards, as a person types them, and their files."""

import csv
import json

import networkx as nx
import pytest
from helpers import run


@pytest.fixture
def floor(tmp_path):
    """A corridor of four places with a room beside each: rooms a, b, c and d."""
    plan = nx.Graph()
    for i, room in enumerate("abcd"):
        plan.add_node(f"hall_{i}", x=10.0 * i, y=0.0)
        plan.add_node(room, x=10.0 * i, y=6.0)
        plan.add_edge(f"hall_{i}", room, length=6.0)
        if i:
            plan.add_edge(f"hall_{i - 1}", f"hall_{i}", length=10.0)
    nx.write_graphml(plan, tmp_path / "floor.graphml")
    return tmp_path / "floor.graphml"


def test_two_guards_get_a_round_for_tonight(capsys, tmp_path, floor):
    given = floor, "--robots", 2, "--speed", 1, "--attack-time", 60
    out = tmp_path / "out"
    status, answer, said = run(capsys, "patrol guard", *given, "--hours", 0.1, "--out", out)
    assert status == 0
    assert answer["answer"][0].startswith("No intruder who needs 60 s escapes, whatever they see")
    assert answer["longest_between"] == pytest.approx(44)
    assert (answer["risk"], answer["watched_capture"]) == (0, 1)
    assert "left out" not in said
    files = {path.name for path in out.iterdir()}
    assert {"schedule.csv", "rounds.png", "patrol.json", "game.json", "guard.rrd"} <= files
    with (out / "schedule.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["robot"] for row in rows} == {"1", "2"}
    assert 350 < float(rows[-1]["time_s"]) <= 360
    robots = json.loads((out / "patrol.json").read_text())["robots"]
    assert {"vertex", "time", "until", "x", "y"} == robots[0]["visits"][0].keys()
    status, again, _ = run(capsys, "patrol evaluate", out / "game.json", out / "patrol.json")
    assert status == 0
    assert again["targets"] == answer["targets"]
    for file, what in (("game", "a game of patrols"), ("patrol", "routes of guards")):
        assert run(capsys, "doctor", out / f"{file}.json")[1]["what"] == what
    status, again, _ = run(capsys, "patrol guard", out / "game.json")
    assert again["guards"] == answer["guards"]


def test_targets_with_short_attacks_come_first(capsys, tmp_path, floor):
    (tmp_path / "times.txt").write_text("a 40\nd 80\n")
    (tmp_path / "values.txt").write_text("a 1\nd 3\n")
    given = "--targets", "a", "d", "--attack-times", tmp_path / "times.txt"
    given = *given, "--values", tmp_path / "values.txt", "--speed", 1
    status, answer, _ = run(capsys, "patrol guard", floor, *given)
    assert status == 0
    # The guard stays at a until d is at the same risk: (84 - 40) / T = 3 (1 - 80 / T).
    period = (3 * 80 + 44) / 3
    first, second = answer["targets"]
    assert answer["risk"] == pytest.approx(44 / period)
    assert (first["target"], first["exposure"]) == ("a", pytest.approx(44 / period))
    assert (second["target"], second["exposure"]) == ("d", pytest.approx(1 - 80 / period))
    assert answer["bound_between"] == pytest.approx(84)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--robots", 2), "expected one of --attack-time or --attack-times"),
        (("--attack-time", 9, "--targets", "z"), "--targets: there is no vertex 'z'"),
        (("--attack-time", 9, "--adversary", "clever"), "clever"),
    ],
)
def test_incomplete_questions_are_refused(capsys, floor, words, message):
    status, _, said = run(capsys, "patrol guard", floor, *words)
    assert status == 2
    assert message in said


def test_walks_of_a_directed_graph_point_to_rounds(capsys, tmp_path):
    nx.write_graphml(nx.cycle_graph(3, create_using=nx.DiGraph), tmp_path / "ways.graphml")
    status, _, said = run(capsys, "patrol graph", tmp_path / "ways.graphml")
    assert status == 2
    assert "rounds on one-way edges are found by `jaxcell patrol guard`" in said
    status, answer, _ = run(capsys, "patrol guard", tmp_path / "ways.graphml", "--attack-time", 3)
    assert (status, answer["risk"]) == (0, 0)
    described = run(capsys, "doctor", tmp_path / "ways.graphml")[1]
    assert (described["edges"], described["one_way"]) == (3, 3)
