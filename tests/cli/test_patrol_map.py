import re

import pytest
from helpers import run

from jaxcell import bundled
from jaxcell.patrol import Attack, capture_probabilities, cell_graph, distributed_policies
from jaxcell.space import CellSpace, Workspace, visible_cells
from jaxcell.space.sight import AT_CENTRE


LAB = bundled("lab_b")
NEAR = ("--range", 2.5, "--attack-times", 4, 9, "--runs", 200)


def test_a_map_in_view_of_all_robots_has_no_fitted_law(capsys, tmp_path):
    (tmp_path / "two.txt").write_text("; cell 1\n..\n")
    status, answer, _ = run(capsys, "patrol map", tmp_path / "two.txt", "--attack-times", 3)
    assert status == 0
    assert "fit" not in answer["attack"]
    assert "different values" in answer["attack"]["failure"]
    (one,) = answer["attack"]["probabilities"]
    assert (one["exact"], one["fitted"]) == (1, None)
    assert answer["policies"][0]["tour_steps"] == 0


def test_the_fewest_robots_for_a_capture(capsys):
    wanted = ("--robots", "auto", "--capture", 0.6, "--share", 0)
    status, answer, _ = run(capsys, "patrol map", LAB, *NEAR, *wanted)
    assert status == 0
    cells = CellSpace.of(Workspace.load(LAB), 1.0, 8)
    graph, visible = cell_graph(cells), visible_cells(cells, 2.5, part=AT_CENTRE)
    reached = [one["size_capture"] for one in answer["team_sizes"]]
    for robots, least in enumerate(reached, 1):
        policies = distributed_policies(graph, visible, robots, 0.0)
        exact = capture_probabilities(graph, visible, policies, Attack(4))
        assert least == pytest.approx(exact.min())
    assert answer["robots"] == len(answer["policies"]) == len(reached) > 1
    assert reached[-2] < 0.6 <= reached[-1]


def test_a_capture_beyond_the_largest_team_has_no_answer(capsys, monkeypatch):
    monkeypatch.setattr("jaxcell.study.patrol.teams.MAX_ROBOTS", 2)
    wanted = ("--robots", "auto", "--capture", 0.999, "--share", 0)
    status, answer, error = run(capsys, "patrol map", LAB, *NEAR, *wanted)
    assert status == 1
    assert len(answer["team_sizes"]) == 2
    assert re.search(r"2 robots capture with a probability of 0\.\d+ at least; 0.999 is not", error)
