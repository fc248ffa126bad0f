import json
import re
from pathlib import Path

import pytest

from jaxcell.cli import main
from jaxcell.patrol import Attack, capture_probabilities, cell_graph, distributed_policies
from jaxcell.space import CellSpace, Workspace, visible_cells
from jaxcell.space.sight import AT_CENTRE


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
    """The probabilities of capture of attacks on the target."""
    return found["attack"]["probabilities"]


@pytest.fixture
def hall(tmp_path):
    """A hall with a wall that does not reach across, which has room for a base station."""
    path = tmp_path / "hall.json"
    wall = [[4, 1], [5, 1], [5, 4], [4, 4]]
    Workspace([[0, 0], [12, 0], [12, 5], [0, 5]], [wall], cell=1.0, directions=8).save(path)
    return path


def test_a_map_in_view_of_all_robots_has_no_fitted_law(capsys, tmp_path):
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
    assert "reason why no law is fitted" in capsys.readouterr().out


def test_a_target_that_the_base_watches_is_refused(capsys, hall):
    where = ("--base", "8.5,2.5", "--base-range", 2, "--target", "8.5,1.5")
    status, _, error = run(capsys, *NEAR, *where, map=hall)
    assert status == 2
    assert "--target '8.5,1.5': the base station always sees it" in error


def test_the_fewest_robots_for_a_capture(capsys):
    wanted = ("--robots", "auto", "--capture", 0.6, "--share", 0)
    status, found, _ = run(capsys, *NEAR, *wanted)
    assert status == 0
    cells = CellSpace.of(Workspace.load(LAB), 1.0, 8)
    graph, visible = cell_graph(cells), visible_cells(cells, 2.5, part=AT_CENTRE)
    reached = [one["size_capture"] for one in found["team_sizes"]]
    for robots, least in enumerate(reached, 1):
        policies = distributed_policies(graph, visible, robots, 0.0)
        assert least == pytest.approx(
            capture_probabilities(graph, visible, policies, Attack(4)).min()
        )
    assert found["robots"] == len(found["policies"]) == len(reached) > 1
    assert reached[-2] < 0.6 <= reached[-1]


def test_a_capture_beyond_the_largest_team_has_no_answer(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.study.patrol.patrol_map._MAX_ROBOTS", 2)
    status, found, error = run(capsys, *NEAR, "--robots", "auto", "--capture", 0.999, "--share", 0)
    assert status == 1
    assert len(found["team_sizes"]) == 2
    assert re.search(r"2 robots capture with a probability of 0\.\d+ at least; 0.999 is not", error)
