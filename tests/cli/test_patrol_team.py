"""Teams of patrollers: the comparison with a round, and results that lack a secondary quantity."""

import importlib
import json
import math
from fractions import Fraction

import networkx as nx
import numpy as np
import pytest
import xarray
from helpers import run

from jaxcell.cli import main


def saved(folder, network):
    path = folder / "graph.json"
    path.write_text(json.dumps(nx.node_link_data(network, edges="edges")))
    return path


def fails(*given, **options):
    raise RuntimeError("the solver stalled (residual 1, tolerance 0); throw=False returns it")


def singular(*given, **options):
    raise np.linalg.LinAlgError("Singular matrix")


CAPTURE = "--strategy", "capture", "--attack-time"


@pytest.mark.parametrize(
    ("module", "function", "options", "missing", "what"),
    [
        ("walks.measures", "hitting_matrix", (), "mean_hitting_time", "table of hitting times"),
        ("walks.measures", "kemeny_constant", (), "kemeny_constant", "Kemeny constant"),
        ("walks.measures", "slem", (), "slem", "second largest eigenvalue"),
        ("walks.measures", "mixing_time", (), "mixing_time", "mixing time"),
        ("walks.graph_patrol", "mean_first_arrival", ("--robots", 2), "mean_first_arrival", "mean"),
        ("team", "timed", ("--speed", 1), "timed", "table of times in seconds"),
        ("team", "age_of_news", ("--base", "0"), "news", "age of news"),
        ("team", "charged", ("--charger", "0", "--every", 12), "charged", "walk that returns"),
        ("team", "simulate_idleness", ("--baselines",), "idleness", "simulation of patrols"),
        ("team", "evenly_spaced_round", ("--robots", 2), "round", "evenly spaced round"),
        ("walks", "memory_patrol", (*CAPTURE, 8, "--memory-states", 2), "walks_with_memory", "sea"),
    ],
)
@pytest.mark.parametrize("failure", [fails, singular])
def test_secondary_quantity_that_fails_is_left_out_with_a_sentence(
    capsys, monkeypatch, tmp_path, module, function, options, missing, what, failure
):
    network = nx.cycle_graph(5)
    nx.set_edge_attributes(network, 1.0, "length")
    file = saved(tmp_path, network)
    monkeypatch.setattr(importlib.import_module(f"jaxcell.patrol.{module}"), function, failure)
    out = "--out", tmp_path / "results"
    status, answer, said = run(capsys, "patrol graph", file, *options, *out)
    assert status == 0
    assert missing not in answer
    assert answer["vertices"]
    sentence = next(line for line in said.splitlines() if "is left out: " in line)
    assert what in sentence
    assert "throw" not in sentence
    assert {path.name for path in (tmp_path / "results").iterdir()} >= {"summary.json", "patrol.nc"}


@pytest.mark.parametrize(
    ("module", "function", "options", "missing"),
    [
        ("map", "capture_frontier", ("--strategy", "capture", "--frontier", 0), "frontier"),
        ("map", "reassign", ("--base", "auto", "--lost", 1), "reassignment"),
        ("team", "round_on_map", (), "round"),
    ],
)
def test_secondary_quantity_of_a_map_that_fails_is_left_out(
    capsys, monkeypatch, module, function, options, missing
):
    monkeypatch.setattr(importlib.import_module(f"jaxcell.patrol.{module}"), function, fails)
    monkeypatch.setattr("jaxcell.patrol.map.capture_search.STEPS", 2)
    short = "--attack-times", 8, "--runs", 50
    status, answer, said = run(capsys, "patrol map", "@lab_a", "--range", 5, *short, *options)
    assert (status, isinstance(answer.get(missing), dict)) == (0, False)
    assert "is left out: the solver stalled (residual 1, tolerance 0)\n" in said


@pytest.mark.parametrize(("vertices", "robots", "attack"), [(6, 2, 3), (8, 2, 4), (9, 3, 3)])
def test_round_that_captures_all_is_beside_a_team_on_a_cycle(
    capsys, tmp_path, vertices, robots, attack
):
    file = saved(tmp_path, nx.cycle_graph(vertices))
    status, answer, said = run(capsys, "patrol graph", file, *CAPTURE, attack, "--robots", robots)
    assert status == 0
    beside = answer["round"]
    assert beside["watched_capture"] == beside["least_capture"] == 1
    assert beside["steps_between"] == attack
    assert answer["least_capture"] < 1
    assert "a round captures more than" in said
    assert "best" not in said


def test_team_is_not_refused_because_one_robot_cannot_cross(capsys):
    """Each of four robots goes back and forth on its part of a line of 20 vertices."""
    status, answer, said = run(capsys, "patrol graph", "@line", *CAPTURE, 8, "--robots", 4)
    assert status == 0
    assert 0 < answer["least_capture"] <= 1
    assert "each robot stays in its own part of the graph" in said
    for robots in (1, 2):
        status, _, said = run(capsys, "patrol graph", "@line", *CAPTURE, 8, "--robots", robots)
        assert status == 2
        assert "attack-time: a robot needs" in said
    assert "or more robots: each of 2 patrols a part" in said


def test_travel_times_are_rounded_up_and_the_round_has_true_lengths(capsys, tmp_path):
    """A square with sides of 14 m at 1 m/s: no attack of 40 s is certain to fail."""
    network = nx.cycle_graph(4)
    nx.set_edge_attributes(network, 14.0, "length")
    given = saved(tmp_path, network), *CAPTURE, 40, "--speed", 1, "--time-unit", 10
    status, answer, said = run(capsys, "patrol graph", *given)
    assert status == 0
    assert answer["round"]["seconds_between"] == 56
    assert answer["round"]["least_capture"] == pytest.approx(40 / 56)
    assert answer["least_capture"] <= 40 / 56
    assert "no attack succeeds" not in said
    assert "rounded up to whole units of time, by up to 6 s; with a smaller --time-unit" in said
    assert "a round captures attacks that begin at a random time with 0.714 at least" in said
    assert answer["least_capture"] <= answer["least_blind_capture"] <= 40 / 56
    assert answer["least_captured"] == "0 and 3 others"


def test_round_that_captures_no_more_than_the_walk_is_not_said_to(capsys, tmp_path):
    status, answer, said = run(
        capsys, "patrol graph", saved(tmp_path, nx.cycle_graph(4)), *CAPTURE, 4
    )
    assert status == 0
    assert answer["least_capture"] == pytest.approx(1, abs=1e-6)
    assert "a round captures" not in said


def test_round_is_printed_whole_and_in_order(capsys, tmp_path):
    network = nx.relabel_nodes(nx.cycle_graph(30), "the room number {}".format)
    command = ["patrol", "graph", str(saved(tmp_path, network)), "--robots", "2"]
    assert main(command) == 0
    shown = capsys.readouterr().out.split("Tours")[1]
    cells = [line.split("│")[3] for line in shown.splitlines() if line.startswith("│")]
    said = " ".join(" ".join(cells).split())
    tour = [0, *range(29, 0, -1)] if "0, the room number 29" in said else range(30)
    assert ", ".join(f"the room number {vertex}" for vertex in tour) in said


def test_first_lines_of_a_team_are_of_the_team(capsys, tmp_path):
    file = saved(tmp_path, nx.cycle_graph(6))
    command = ["patrol", "graph", str(file), *CAPTURE, "3", "--robots", "2"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    answer = json.loads((tmp_path / "out" / "summary.json").read_text())
    lines = [line for line in shown.splitlines() if line.startswith("│")]
    heads = " ".join(" ".join(line.split("│")[1] for line in lines[:3]).split())
    assert heads.startswith(
        "least chance of capture, if the adversary sees the patrollers at vertices"
    )
    assert heads.endswith("vertex where it is least")
    assert "mean hitting time" not in shown
    assert "never" not in shown
    # The adversary waits until all robots are at their worst places.
    captured = {row["vertex"]: row["captured"] for row in answer["vertices"]}
    first, *others = answer["least_captured"].split(" and ")
    tied = sum(one <= min(captured.values()) + 1e-6 for one in captured.values())
    assert others == [f"{tied - 1} other" + "s" * (tied > 2)] * (tied > 1)
    assert captured[first] - 1e-6 <= min(captured.values()) == answer["least_capture"]
    # The shares of time are those of a robot drawn at random: all vertices are visited.
    shares = [row["stationary"] for row in answer["vertices"]]
    assert sum(shares) == pytest.approx(1)
    assert min(shares) > 0


def test_patrol_of_a_map_names_the_place_that_a_watcher_attacks(capsys):
    given = "@lab_a", "--range", 5, "--attack-times", 8, "--runs", 50
    _, answer, said = run(capsys, "patrol map", *given)
    _, worst, _ = run(capsys, "patrol map", *given, "--distribution", "worst")
    assert answer["watched_capture"] == pytest.approx(worst["least_capture"], abs=1e-12)
    assert answer["watched_capture"] <= answer["least_capture"]
    assert answer["watched_place"] == worst["least_captured"]
    assert math.isfinite(answer["round"]["steps_between"])
    assert "evenly spaced robots on one closed tour, which keep a shared clock, capture" in said


def test_unit_of_time_is_chosen_and_said(capsys, tmp_path):
    """Sides of 12 and 8 s, attacks of 100 s: only units of 4 s, 1/25, would round nothing."""
    network = nx.cycle_graph(4)
    sides = dict(zip(network.edges, (12, 8, 8, 8), strict=True))
    nx.set_edge_attributes(network, sides, "length")
    out = tmp_path / "out"
    given = *CAPTURE, 100, "--speed", 1, "--out", out
    status, answer, _ = run(capsys, "patrol graph", saved(tmp_path, network), *given)
    assert status == 0
    sums = {
        Fraction(100, parts): sum(-(-side * parts // 100) for side in sides.values())
        * Fraction(100, parts)
        for parts in range(1, 25)
    }
    unit = float(min(sums, key=sums.get))
    assert answer["time_unit"] == pytest.approx(unit)
    options = json.loads((out / "result.json").read_text())["options"]
    assert options["time_unit"] == pytest.approx(unit)
    # Without attacks, whole seconds; what is typed is taken.
    for more, wanted in (((), 1), (("--time-unit", 2), 2)):
        file = saved(tmp_path, network)
        status, answer, _ = run(capsys, "patrol graph", file, "--speed", 1, *more)
        assert (status, answer["time_unit"]) == (0, wanted)


def test_attack_that_is_too_short_by_rounding_names_the_unit(capsys, tmp_path):
    """A robot needs 20 s to cross a line, and 40 s in units of 10 s, each edge rounded up."""
    network = nx.path_graph(3)
    nx.set_edge_attributes(network, 10.0001, "length")
    given = saved(tmp_path, network), *CAPTURE, 25, "--speed", 1, "--time-unit", 10
    status, _, said = run(capsys, "patrol graph", *given)
    assert status == 2
    assert "or a smaller --time-unit; times are rounded to units of 10 s" in said


def test_walks_with_memory_stand_beside_simulated_baselines(capsys, tmp_path):
    file = saved(tmp_path, nx.cycle_graph(5))
    options = *CAPTURE, 3, "--memory-states", 2, "--baselines", "--out", tmp_path / "results"
    assert run(capsys, "patrol graph", file, *options)[0] == 0
    with xarray.open_dataset(tmp_path / "results" / "patrol.nc") as dataset:
        assert dataset["walk"].values.tolist()[:2] == ["memory 1", "memory 2"]
        assert dataset["idleness_mean"].size > 1
