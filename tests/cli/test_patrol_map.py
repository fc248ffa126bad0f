import contextlib
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcell.cli import main
from jaxcell.patrol import capture_probabilities, cell_graph, distributed_policies
from jaxcell.space import CellSpace, Workspace, visible_cells


MAPS = Path(__file__).parents[2] / "data" / "maps"
LAB = MAPS / "lab_b.json"
NEAR = ("--range", 2.5, "--attack-times", 4, 9, "--runs", 200)


def run(capsys, *args, map=LAB):
    """Exit status, the JSON object on standard output, and standard error."""
    status = main(["patrol", "map", str(map), *map_args(args), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out) if captured.out else None, captured.err


def map_args(args):
    return [str(arg) for arg in args]


def probabilities(found):
    """What is known of the attacks on the target."""
    return found["attack"]["probabilities"]


@pytest.fixture(scope="module")
def near():
    """What the command says of two robots that see near cells."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert main(["patrol", "map", str(LAB), *map_args(NEAR), "--json"]) == 0
    return json.loads(said.getvalue())


@pytest.fixture
def hall(tmp_path):
    """A hall with a wall that does not reach across, which has room for a base station."""
    path = tmp_path / "hall.json"
    wall = [[4, 1], [5, 1], [5, 4], [4, 4]]
    Workspace([[0, 0], [12, 0], [12, 5], [0, 5]], [wall], cell=1.0, directions=8).save(path)
    return path


def test_a_patrol_without_a_base(near):
    found = near
    cells = CellSpace.of(Workspace.load(LAB), 1.0, 8)
    graph, visible = cell_graph(cells), visible_cells(cells, 2.5)
    policies = distributed_policies(graph, visible, 2, found["chosen_share"])
    capture = capture_probabilities(graph, visible, policies, [4, 9])
    assert found["positions"] == 19
    assert found["mean_cells_seen"] == pytest.approx(visible.sum() / 19)
    for one, policy in zip(found["policies"], policies, strict=True):
        assert one["cover"] == policy.cover.tolist()
        # No fewer cells see all, which there are few enough to try.
        assert visible[one["cover"]].any(axis=0).all()
        assert 1 <= one["minimum_cover"] <= len(one["cover"])
        assert one["cover_ratio"] == len(one["cover"]) / one["minimum_cover"]
        assert one["commute_time"] == pytest.approx(policy.commute_time)
        assert "contact" not in one
    target = found["attack"]["target"]["cell"]
    assert target == capture[0].argmin()
    for row, one, at_target in zip(
        capture, found["attacks"], found["attack"]["probabilities"], strict=True
    ):
        assert one["weakest"]["cell"] == row.argmin()
        assert one["weakest_capture"] == pytest.approx(row.min())
        assert one["mean_capture"] == pytest.approx(row.mean())
        one = at_target
        assert one["exact"] == pytest.approx(row[target])
        assert abs(one["simulated"] - one["exact"]) < 0.15
        fitted = one["fitted"] is not None
        assert fitted == ("fit" in found["attack"]) == ("failure" not in found["attack"])
        if fitted:
            assert one["fit_gap"] == pytest.approx(one["fitted"] - one["exact"])
    assert [one["share"] for one in found["shares"]] == [0, 0.2, 0.5, 0.8]
    tried = [one["share_capture"] for one in found["shares"]]
    assert max(tried) == pytest.approx(capture[0].min())
    assert found["shares"][tried.index(max(tried))]["share"] == found["chosen_share"]
    assert not {"regions", "reassignment", "when_a_robot_is_lost"} & found.keys()


def test_a_base_and_a_robot_that_is_lost(capsys, hall):
    args = ("--robots", 3, "--base", "auto", "--base-range", 2, "--lost", 2)
    status, found, _ = run(capsys, *NEAR, *args, map=hall)
    assert status == 0
    base = found["regions"]
    assert base["count"] == len(found["policies"]) == 3
    assert base["cells_in_view"] >= base["patrolled_by_nobody"] > 0
    patrolled = [one["cells_patrolled"] for one in found["policies"]]
    assert sum(patrolled) + base["patrolled_by_nobody"] == found["positions"]
    assert all(one["contact"] is not None for one in found["policies"])
    after = found["reassignment"]
    assert after["robot"] == [0, 1] or after["robot"] == [1, 0]
    before, meanwhile, _ = found["when_a_robot_is_lost"]
    assert meanwhile["phase_mean"] < before["phase_mean"]
    assert before["phase_weakest"] == found["attacks"][0]["weakest_capture"]
    assert after["silence_limit"] > 1
    x, y = base["base"]["x"], base["base"]["y"]
    there = run(capsys, *NEAR, *args[:2], "--base", f"{x},{y}", "--base-range", 2, map=hall)[1]
    assert there["regions"] == base
    assert "reassignment" not in there


def test_a_target_and_a_share_of_choice(capsys):
    _, found, _ = run(capsys, *NEAR, "--target", "5.5,3.5", "--share", 0.6, "--robots", 1)
    assert (found["attack"]["target"]["x"], found["attack"]["target"]["y"]) == (5.5, 3.5)
    assert [one["share"] for one in found["shares"]] == [0, 0.6]
    assert found["chosen_share"] == 0.6
    assert len(found["policies"]) == 1


def test_a_patrol_that_captures_most(near, capsys, tmp_path):
    options = ("--strategy", "capture", "--randomness", 0.1, "--frontier", 0.5, "--starts", 2)
    status, found, error = run(capsys, *NEAR, *options, "--out", tmp_path)
    assert status == 0
    assert "the patrol is a local optimum, the best of 2 starts; another may capture more" in error
    commuting = near["attacks"][0]["weakest_capture"]
    assert found["attacks"][0]["weakest_capture"] > 1.2 * commuting
    assert found["search"]["value"] == pytest.approx(found["attacks"][0]["weakest_capture"])
    assert [one["floor"] for one in found["frontier"]["floors"]] == [0.5]
    assert "chosen_share" not in found or found["chosen_share"] is None
    chains = json.loads((tmp_path / "patrol.json").read_text())
    assert len(chains["robots"]) == 2


def test_another_seed_says_something_else(near, capsys):
    """That the same seed says the same is in the golden files."""
    _, other, _ = run(capsys, *NEAR, "--seed", 1)
    simulated = [[one["simulated"] for one in probabilities(found)] for found in (near, other)]
    assert simulated[0] != simulated[1]


def test_tables_for_people(capsys, hall):
    args = ["patrol", "map", *map_args((hall, *NEAR, "--base", "auto", "--base-range", 2))]
    assert main([*args, "--robots", "3", "--lost", "0"]) == 0
    out = capsys.readouterr().out
    assert "57 cells" in out
    assert re.search(r"When a robot is lost *\n", out)
    assert re.search(r"│ steps of silence that mean a loss +│ [\d,]+ steps +│", out)
    assert re.search(r"│ all robots +│ [\d.]+ % +│ [\d.]+ % +│", out)
    assert re.search(r"│ 4 steps +│ \([\d.]+, [\d.]+\) +│ [\d.]+ % +│", out)
    assert "share of steps on the tours" in out


def test_where_all_is_in_view_there_is_nothing_to_fit(capsys, tmp_path):
    (tmp_path / "two.txt").write_text("; cell 1\n..\n")
    status, found, _ = run(capsys, "--attack-times", 3, map=tmp_path / "two.txt")
    assert status == 0
    assert "fit" not in found["attack"]
    assert "different values" in found["attack"]["failure"]
    (one,) = probabilities(found)
    assert one["exact"] == 1
    assert one["fitted"] is None
    assert found["policies"][0]["tour_steps"] == 0
    assert main(["patrol", "map", str(tmp_path / "two.txt"), "--runs", "9"]) == 0
    assert "why no law is fitted" in capsys.readouterr().out


def test_writes_its_results(capsys, tmp_path):
    out = tmp_path / "new" / "out"
    status, found, _ = run(capsys, *NEAR, "--out", out)
    assert status == 0
    assert {path.name for path in out.iterdir()} == {
        "patrol_map.nc",
        "patrol_map.rrd",
        "patrol.json",
        "summary.json",
    }
    assert json.loads((out / "summary.json").read_text()) == found
    with xr.open_dataset(out / "patrol_map.nc") as dataset:
        np.testing.assert_allclose(
            dataset.attack_exact, [one["exact"] for one in probabilities(found)], atol=1e-12
        )
        assert dataset.attack_target == found["attack"]["target"]["cell"]
        spec = json.loads(dataset.attrs["spec"])
        assert (spec["robots"], spec["range_m"], spec["attack_times"]) == (2, 2.5, [4, 9])


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--range", 0), "--range: expected more than 0 m, and finite, got 0"),
        (("--range", "nan"), "--range: .* got nan"),
        (("--range", "inf"), "--range: .* got inf"),
        (("--range", 0.3), "--range: with 0.3 m no robot ever sees the whole of a cell"),
        (("--robots", 0), "--robots: expected at least 1, got 0"),
        (("--robots", 20), "--robots: 20 robots are more than the 19 cells of .*lab_b.json"),
        (("--share", 1), "--share: expected 0 or more and less than 1, got 1"),
        (("--attack-times", 5, 0), "--attack-times: expected at least 1 step, got 0"),
        (("--randomness", 0.2), "--randomness has no meaning for 'commute'"),
        (("--starts", 5), "--starts has no meaning for 'commute'"),
        (("--frontier", 0.2), "--frontier has no meaning for 'commute'"),
        (("--strategy", "capture", "--share", 0.5), '--share has no meaning for "capture"'),
        (("--strategy", "capture", "--base", "auto"), '--base has no meaning for "capture"'),
        (("--strategy", "capture", "--frontier", 1), "--frontier: expected 0 or more and less"),
        (("--runs", 1), "--runs: expected 2 or more, up to 10,000,000, got 1"),
        (("--target", "3.5,2.5"), r"--target '3.5,2.5': the point \(3.5, 2.5\) lies in an obst"),
        (("--target", "99,1"), "--target '99,1': .* is off the map"),
        (("--target", "here"), "--target 'here': expected \"x,y\" in metres"),
        (("--base", "3.5,2.5"), "--base '3.5,2.5': .* lies in an obstacle"),
        (("--base", "auto", "--base-range", 0.4), "--base: .* sees no other cell"),
        (("--base", "auto", "--base-range", -1), "--base-range: expected more than 0 m"),
        (("--base-range", 3), "--base-range has no meaning without a base"),
        (("--lost", 0), "--lost has no meaning without a base"),
        (("--base", "auto", "--lost", 2), "--lost: there is no robot 2; robots are 0 to 1"),
        (("--base", "auto", "--lost", 0, "--robots", 1), "--lost: robot 0 is the only one"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, args, message):
    status, found, error = run(capsys, *args)
    assert (status, found) == (2, None)
    assert error.count("\n") == 1
    assert re.search(f"^jaxcell patrol map: {message}", error), error


def test_a_target_that_the_base_watches_is_refused(capsys, hall):
    where = ("--base", "8.5,2.5", "--base-range", 2, "--target", "8.5,1.5")
    status, _, error = run(capsys, *NEAR, *where, map=hall)
    assert status == 2
    assert "--target '8.5,1.5': the base station always sees it" in error


def test_bad_maps_are_one_line_and_status_2(capsys, tmp_path, monkeypatch):
    (tmp_path / "rooms.txt").write_text("; cell 1\n...#..\n...#..\n")
    for name, message in (
        ("rooms.txt", r"2 separate pieces; no way leads from \(0.5, 0.5\) to \(4.5, 0.5\)"),
        ("none.json", "there is no such file"),
    ):
        status, found, error = run(capsys, map=tmp_path / name)
        assert (status, found) == (2, None)
        assert re.fullmatch(rf"jaxcell patrol map: .*{name}: .*{message}.*\n", error), error
    monkeypatch.setattr("jaxcell.study.patrol_map.MAX_CELLS", 18)
    status, _, error = run(capsys)
    assert status == 2
    assert "cells of 1 m are 19; policies are computed for at most 18" in error


def test_no_answer_is_status_1(capsys, monkeypatch):
    def stalls(*args, **options):
        raise RuntimeError("the residual stayed above the tolerance")

    monkeypatch.setattr("jaxcell.patrol.distributed_policies", stalls)
    status, found, error = run(capsys, *NEAR)
    assert (status, found) == (1, None)
    assert error == "jaxcell patrol map: the residual stayed above the tolerance\n"


def test_the_fewest_robots_for_a_capture(capsys):
    wanted = ("--robots", "auto", "--capture", 0.6, "--share", 0)
    status, found, _ = run(capsys, *NEAR, *wanted)
    assert status == 0
    cells = CellSpace.of(Workspace.load(LAB), 1.0, 8)
    graph, visible = cell_graph(cells), visible_cells(cells, 2.5)
    reached = [one["size_capture"] for one in found["team_sizes"]]
    for robots, least in enumerate(reached, 1):
        policies = distributed_policies(graph, visible, robots, 0.0)
        assert least == pytest.approx(capture_probabilities(graph, visible, policies, [4]).min())
    assert found["robots"] == len(found["policies"]) == len(reached) > 1
    assert reached[-2] < 0.6 <= reached[-1]


def test_more_robots_than_are_tried(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.study.patrol_map._MAX_ROBOTS", 2)
    status, found, error = run(capsys, *NEAR, "--robots", "auto", "--capture", 0.999, "--share", 0)
    assert status == 1
    assert len(found["team_sizes"]) == 2
    assert re.search(r"2 robots capture with a probability of 0\.\d+ at least; 0.999 is not", error)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--robots", "auto"), '"auto" with a wanted capture, and only then'),
        (("--capture", 0.5), '"auto" with a wanted capture, and only then'),
        (("--robots", "auto", "--capture", 1.5), "expected more than 0 and less than 1"),
        (
            ("--robots", "auto", "--capture", 0.5, "--base", "auto"),
            '--base has no meaning with robots "auto"',
        ),
    ],
)
def test_teams_of_unknown_size_are_refused_where_nothing_is_wanted(capsys, args, message):
    status, found, error = run(capsys, *args)
    assert (status, found) == (2, None)
    assert message in error
