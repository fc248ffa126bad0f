import dataclasses
import json

import numpy as np
import pytest
import xarray as xr

from jaxcell.bounce import TeamOutcome, team_trajectories, team_trajectory
from jaxcell.record import log_team, save_dataset, team_dataset
from jaxcell.record.team import robot_color
from jaxcell.space import CellSpace


BOUNCE = np.radians(135)


@pytest.fixture(scope="module")
def team(lab):
    """A team that covers the lab in several parts, with collisions."""
    rng = np.random.default_rng(0)
    starts = [rng.choice(19, 3, replace=False) + 19 * rng.integers(8, size=3) for _ in range(20)]
    runs = team_trajectories(lab.cells, np.array(starts), BOUNCE, collision="endpoint")
    return next(run for run in runs if len(run.parts) > 1 and run.collisions.max() > 0)


@pytest.fixture(scope="module")
def recorded(lab, team, read, tmp_path_factory):
    path = tmp_path_factory.mktemp("team") / "team.rrd"
    log_team(path, lab.cells, team, spec={"seed": 0})
    return read(path)


def test_dataset(lab, team, tmp_path):
    save_dataset(team_dataset(lab.cells, team, spec={"seed": 0}), tmp_path / "team.nc")
    with xr.open_dataset(tmp_path / "team.nc") as found:
        for name in ("bumped", "collided", "collisions", "covered"):
            np.testing.assert_array_equal(found[name], getattr(team, name))
        np.testing.assert_array_equal(found.cell, team.path)
        np.testing.assert_array_equal(found.part_begin, team.parts)
        np.testing.assert_array_equal(
            lab.cells.index(found.x.values, found.y.values, found.theta.values), team.path
        )
        assert json.loads(found.attrs["spec"]) == {"seed": 0}
        assert found.attrs["outcome"] == team.outcome.name.lower()
        for position in range(lab.cells.positions):
            time = int(found.first_visit[position])
            robot = int(found.first_visitor[position])
            assert team.path[time, robot] % lab.cells.positions == position
            assert not (team.path[:time] % lab.cells.positions == position).any()
            x, y = found.position_x.values[position], found.position_y.values[position]
            assert lab.cells.index(x, y) == position


def test_what_is_never_visited_is_marked(lab):
    team = team_trajectory(lab.cells, [0], BOUNCE, max_parts=1, part_steps=2)
    assert team.outcome is TeamOutcome.OUT_OF_PARTS
    found = team_dataset(lab.cells, team)
    np.testing.assert_array_equal(np.flatnonzero(found.first_visit == -1), team.uncovered)
    np.testing.assert_array_equal(np.flatnonzero(found.first_visitor == -1), team.uncovered)


def test_robots_and_trails(lab, team, recorded):
    for robot, path in enumerate(team.path.T):
        origins = recorded.over("step", f"/map/robot_{robot}", "Arrows2D:origins")
        vectors = recorded.over("step", f"/map/robot_{robot}", "Arrows2D:vectors")
        trails = recorded.over("step", f"/map/trail_{robot}", "LineStrips2D:strips")
        x, y, theta = lab.cells.centre(path)
        place = np.stack([x, y], axis=1)
        assert list(origins) == list(vectors) == list(trails) == list(range(len(path)))
        for time in range(len(path)):
            vector = np.array(vectors[time])[0]
            np.testing.assert_allclose(np.array(origins[time])[0] + vector / 2, place[time])
            heading = [np.cos(theta[time]), np.sin(theta[time])]
            np.testing.assert_allclose(vector / np.hypot(*vector), heading, atol=1e-6)
            (trail,) = trails[time]
            np.testing.assert_allclose(trail[-1], place[time])
            assert len(trail) <= 7
            # The trail ends with the straight run since the last turn.
            turns = np.flatnonzero(np.diff(path[: time + 1] // lab.cells.positions)) + 1
            last = turns[-1] if turns.size else 0
            np.testing.assert_allclose(trail[-2], place[last])


def test_squares_fill_in_the_colour_of_the_first_robot(lab, team, recorded):
    labels = recorded.classes("/map/grid/visited")
    assert labels[0] == "not visited"
    for robot in range(3):
        expected = f"first visited by robot {robot} ({robot_color(robot)[0]})"
        assert labels[1 + robot] == expected
    pictures = recorded.pictures("step", "/map/grid/visited")
    first = {}
    for time, joint in enumerate(team.path.tolist()):
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
    assert list(marks) == list(range(len(team.path)))
    assert not marks[0]
    for move, collided in enumerate(team.collided):
        x, y, _ = lab.cells.centre(team.path[move + 1][collided])
        np.testing.assert_allclose(np.reshape(marks[move + 1], (-1, 2)), np.stack([x, y], axis=1))
    curves = {
        name: np.array(list(recorded.over("step", f"/team/{name}", "Scalars:scalars").values()))
        for name in ("covered", "collisions", "part")
    }
    np.testing.assert_array_equal(curves["covered"][:, 0], team.covered)
    np.testing.assert_array_equal(np.diff(curves["collisions"][:, 0]), team.collisions)
    assert (np.flatnonzero(np.diff(curves["part"][:, 0])) + 1).tolist() == team.parts[1:].tolist()
    assert recorded.timelines >= {"step"}
    assert recorded.blueprints


def test_the_text_says_what_came_out(team, recorded):
    text = recorded.static("/text", "TextDocument:text")[0]
    assert f"all 19 positions** in **{len(team.path) - 1} steps" in text
    assert "| 0 | vermilion | x = " in text
    assert "| seed | 0 |" in text


def test_a_long_trajectory_is_thinned(lab, read, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxcell.record.team._MOST_TIMES", 8)
    monkeypatch.setattr("jaxcell.record.team._MOST_PICTURES", 3)
    team = team_trajectory(lab.cells, [0, 31], BOUNCE, max_parts=3)
    log_team(tmp_path / "thin.rrd", lab.cells, team)
    thin = read(tmp_path / "thin.rrd")
    steps = len(team.path) - 1
    assert steps > 16
    stride = -(-steps // 8)
    times = sorted({*range(0, steps, stride), steps})
    assert list(thin.over("step", "/map/robot_1", "Arrows2D:origins")) == times
    pictures = thin.pictures("step", "/map/grid/visited")
    assert len(pictures) == 3
    assert np.count_nonzero(pictures[max(pictures)]) == team.covered[-1]
    marks = thin.over("step", "/map/collisions", "Boxes2D:centers")
    assert sum(len(one or []) for one in marks.values()) == team.collided.sum()
    assert f"every {stride}th is shown" in thin.static("/text", "TextDocument:text")[0]


def test_a_team_that_fills_the_map_is_shown(read, tmp_path):
    cells = CellSpace.of_grid(np.ones((3, 3), bool), 8)
    team = team_trajectory(cells, list(range(9)), BOUNCE)
    log_team(tmp_path / "full.rrd", cells, team)
    pictures = read(tmp_path / "full.rrd").pictures("step", "/map/grid/visited")
    assert list(pictures) == [0]
    # There are eight colours: the ninth robot has the first one.
    assert pictures[0].ravel().tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 1]


def test_refuses_what_is_of_another_map(lab, team, tmp_path):
    small = CellSpace.of_grid(np.ones((2, 2), bool), 8)
    with pytest.raises(ValueError, match=r"team: path\[\d+, \d+\] is cell \d+; cells are 0 to 31"):
        team_dataset(small, team)
    large = CellSpace.of_grid(np.ones((9, 9), bool), 8)
    with pytest.raises(ValueError, match="team: it tells of 19 positions, and there are 81"):
        log_team(tmp_path / "other.rrd", large, team)
    wrong = dataclasses.replace(team, path=team.path - 200)
    with pytest.raises(ValueError, match=r"team: path\[0, 0\] is cell -"):
        team_dataset(lab.cells, wrong)
    assert not list(tmp_path.iterdir())
