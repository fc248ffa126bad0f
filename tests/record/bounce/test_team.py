import numpy as np
import pytest
from recordings import poses_of, read_back

from jaxcell.bounce import TeamOutcome, team_trajectories, team_trajectory
from jaxcell.record import dataset, summary
from jaxcell.record.canvas.palette import robot_color
from jaxcell.space import ENDPOINT, CellSpace, Workspace


BOUNCE = np.radians(135)


@pytest.fixture(scope="module")
def team(lab):
    """A team that covers the lab in several parts, with collisions."""
    rng = np.random.default_rng(0)
    starts = [rng.choice(19, 3, replace=False) + 19 * rng.integers(8, size=3) for _ in range(20)]
    runs = team_trajectories(lab.cells, np.array(starts), BOUNCE, motion=ENDPOINT)
    return next(run for run in runs if run.parts > 1 and run.collisions.max() > 0)


@pytest.fixture(scope="module")
def recorded(lab, team):
    return read_back(team, {"seed": 0})


def test_the_dataset_has_the_first_visit_of_each_position(lab, team):
    visits = dataset(team)
    position = team.cell % lab.cells.positions
    for place in range(lab.cells.positions):
        time, robot = int(visits.first_visit[place]), int(visits.first_visitor[place])
        assert position[time, robot] == place
        assert not (position[:time] == place).any()


def test_positions_without_a_visit_are_marked(lab):
    team = team_trajectory(lab.cells, [0], BOUNCE, max_parts=1, part_steps=2)
    assert team.outcome is TeamOutcome.OUT_OF_PARTS
    found = dataset(team)
    for quantity in (found.first_visit, found.first_visitor):
        np.testing.assert_array_equal(np.flatnonzero(quantity == -1), team.uncovered_positions)


def test_squares_fill_in_the_colour_of_the_first_robot(lab, team, recorded):
    labels = recorded.classes("/map/grid/visited")
    assert labels[0] == "not visited"
    for robot in range(3):
        expected = f"first visited by robot {robot} ({robot_color(robot)[0]})"
        assert labels[1 + robot] == expected
    pictures = recorded.pictures("step", "/map/grid/visited")
    first = {}
    for time, joint in enumerate(team.cell.tolist()):
        before = len(first)
        for robot, z in enumerate(joint):
            first.setdefault(z % lab.cells.positions, robot)
        assert (time in pictures) == (len(first) > before)
        if time in pictures:
            shown = pictures[time].ravel()
            assert {p: shown[lab.cells.square[p]] - 1 for p in first} == first
            assert np.count_nonzero(shown) == len(first) == team.covered[time]


def test_collisions_and_curves(lab, team, recorded):
    marks = recorded.over("step", "/map/collisions", "Boxes2D:centers")
    assert list(marks) == list(range(len(team.cell)))
    assert not marks[0]
    for move, collided in enumerate(team.collided):
        places = poses_of(lab.cells, team.cell[move + 1][collided])[:, :2]
        np.testing.assert_allclose(np.reshape(marks[move + 1], (-1, 2)), places)
    curves = {
        name: np.array(list(recorded.over("step", f"/team/{name}", "Scalars:scalars").values()))
        for name in ("covered", "collisions", "part")
    }
    np.testing.assert_array_equal(curves["covered"][:, 0], team.covered)
    np.testing.assert_array_equal(np.diff(curves["collisions"][:, 0]), team.collisions)
    begins = 1 + np.flatnonzero(np.diff(curves["part"][:, 0]))
    np.testing.assert_array_equal(begins, team.part_begin[1:])


def test_the_text_says_what_came_out(team, recorded):
    text = recorded.text()
    assert "| positions that are visited | 19 |" in text
    assert f"| steps | {len(team.cell) - 1} |" in text
    x, y, theta = map(float, team.cells.centre(int(team.starts[0])))
    pose = f"{x:g} m, {y:g} m, heading {np.rad2deg(theta):g}° (cell {team.starts[0]})"
    assert f"| 0 | vermilion | {pose} |" in text
    assert "| seed | 0 |" in text


def test_a_long_trajectory_is_thinned(lab, monkeypatch):
    monkeypatch.setattr("jaxcell.record.bounce.team.MAX_TIMES", 8)
    monkeypatch.setattr("jaxcell.record.bounce.team.MAX_PICTURES", 3)
    team = team_trajectory(lab.cells, [0, 31], BOUNCE, max_parts=3)
    thin = read_back(team)
    steps = len(team.cell) - 1
    assert steps > 16
    stride = -(-steps // 8)
    times = sorted({*range(0, steps, stride), steps})
    assert list(thin.over("step", "/map/robot_1", "Arrows2D:origins")) == times
    pictures = thin.pictures("step", "/map/grid/visited")
    assert len(pictures) == 3
    assert np.count_nonzero(pictures[max(pictures)]) == team.covered[-1]
    marks = thin.over("step", "/map/collisions", "Boxes2D:centers")
    assert sum(len(one or []) for one in marks.values()) == team.collided.sum()
    assert f"Every {stride}th step is shown" in thin.text()


def test_a_team_that_fills_the_map_is_shown():
    cells = CellSpace.of_grid(np.ones((3, 3), bool), 8)
    team = team_trajectory(cells, list(range(9)), BOUNCE)
    pictures = read_back(team).pictures("step", "/map/grid/visited")
    assert list(pictures) == [0]
    assert pictures[0].ravel().tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9]


def test_wide_robots_have_a_remark():
    room = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], robot_radius=0.4)
    for cell, wide in ((0.5, True), (1.0, False)):
        team = team_trajectory(CellSpace.of(room, cell, 8), [0], BOUNCE, max_parts=1)
        assert (team.remark is not None) == wide == ("remark" in summary(team))
