import math

import numpy as np
import pytest
import shapely
from recordings import packed, poses_of, read_back

from jaxcell import bundled
from jaxcell.bounce import (
    AdaptivelyLocalized,
    Localized,
    bounce_map,
    localization_filter,
    localization_policy,
    localize,
)
from jaxcell.record.bounce.anywhere import stretches
from jaxcell.record.bounce.policy import _tree
from jaxcell.record.canvas.palette import CURRENT, ROBOT
from jaxcell.space import CellSpace, Motion
from jaxcell.study import LocalizeAnywhere


MOST_ARROWS = 400


@pytest.fixture(scope="module")
def lab_run(lab):
    localization = lab.localized(100)
    return localization.run, read_back(localization)


@pytest.fixture(scope="module")
def hall_run(hall):
    localization = hall.localized(7)
    return localization.run, read_back(localization)


@pytest.fixture(params=["lab", "hall"])
def shown(request):
    """A case, a run in it, and the recording of the run."""
    return request.getfixturevalue(request.param), *request.getfixturevalue(f"{request.param}_run")


def test_the_belief_is_the_state_of_the_filter(shown):
    case, run, recorded = shown
    shown = recorded.poses("/map/belief")
    size = recorded.over("step", "/filter/uncertainty", "Scalars:scalars")
    bits = recorded.over("step", "/filter/bits", "Scalars:scalars")
    assert list(shown) == list(size) == list(range(len(run.states)))
    for time, state in enumerate(run.states.tolist()):
        cells = case.filter.cells(state)
        assert size[time] == [len(cells)] == [case.filter.uncertainty[state]]
        assert bits[time] == [pytest.approx(math.log2(len(cells)))]
        expected = poses_of(case.cells, cells if len(cells) <= MOST_ARROWS else [])
        np.testing.assert_allclose(shown[time], expected, atol=1e-5)


def test_a_large_belief_is_shaded(hall, hall_run):
    run, recorded = hall_run
    sizes = hall.filter.uncertainty[run.states]
    assert sizes[0] > MOST_ARROWS >= sizes[-1], "this run has both"
    shades = recorded.pictures("step", "/map/grid/belief")
    large = int(np.sum(sizes > MOST_ARROWS))
    assert list(shades) == list(range(large + 1))
    for time in range(large):
        position = hall.filter.cells(int(run.states[time])) % hall.cells.positions
        count = np.bincount(hall.cells.square[position], minlength=hall.cells.free.size)
        np.testing.assert_array_equal(shades[time].ravel(), np.ceil(count * 8 / 24))
    assert not shades[large].any(), "where arrows take over, no shade is left"


def test_the_robot_and_its_trail(shown):
    case, run, recorded = shown
    robot = recorded.poses("/map/robot")
    trails = recorded.over("step", "/map/trail", "LineStrips2D:strips")
    path = poses_of(case.cells, run.path)
    for time in range(len(run.path)):
        np.testing.assert_allclose(robot[time], path[time : time + 1], atol=1e-5)
        (trail,) = trails[time]
        np.testing.assert_allclose(trail[0], path[0, :2])
        np.testing.assert_allclose(trail[-1], path[time, :2])
        assert len(trail) == 2 + np.sum(run.observations[:time])
        # Between corners the robot runs straight: all places lie on the segments of the trail.
        places = shapely.points(path[: time + 1, :2])
        assert shapely.distance(places, shapely.LineString(trail)).max() < 1e-5


def test_the_end_marks_the_candidates_and_the_truth(lab, lab_run):
    run, recorded = lab_run
    end = len(run.observations)
    boxes = recorded.over("step", "/map/candidates", "Boxes2D:centers")
    assert list(boxes) == [end], "before the end nothing is known"
    np.testing.assert_allclose(boxes[end], poses_of(lab.cells, run.candidates)[:, :2])
    ((x, y),) = poses_of(lab.cells, run.path[-1:])[:, :2].tolist()
    ((label_x, label_y),) = recorded.over("step", "/map/truth", "Points2D:positions")[end]
    assert label_x == pytest.approx(x)
    assert abs(label_y - y) <= 0.5
    assert [x, y] in np.array(boxes[end]).round(6).tolist()


def test_the_filter_is_a_graph_that_lights_up(shown):
    case, run, recorded = shown
    names = recorded.static("/filter/graph", "GraphNodes:node_ids")
    states = [int(name.split()[1].removesuffix(":")) for name in names]
    sizes = [int(name.split()[2]) for name in names]
    assert sizes == case.filter.uncertainty[states].tolist()
    assert len(recorded.static("/filter/graph", "GraphNodes:positions")) == len(names)
    edges = recorded.static("/filter/graph", "GraphEdges:edges")
    number = dict(zip(names, states, strict=True))
    for edge in edges:
        assert number[edge["second"]] in case.filter.transition[number[edge["first"]]]
    colors = recorded.over("step", "/filter/graph", "GraphNodes:colors")
    current, vermilion = map(packed, (CURRENT, ROBOT))
    seen = set()
    for time, state in enumerate(run.states.tolist()):
        now = list(zip(states, colors[time], strict=True))
        assert {s for s, color in now if color == current} == {state} & set(states)
        been = {s for s, color in now if color == vermilion and case.filter.color[s] == 1}
        assert been == (seen - {state}) & set(states)
        seen.add(state)
    assert run.states[-1] in states


def test_groups_follow_the_heading(lab, lab_run):
    run, recorded = lab_run
    by_direction = recorded.pictures("direction", "/map/grid/bounce_45/groups")
    by_step = recorded.pictures("step", "/map/grid/bounce_45/groups")
    heading = run.path // lab.cells.positions
    for time, now in enumerate(heading.tolist()):
        shown = by_step[max(t for t in by_step if t <= time)]
        np.testing.assert_array_equal(shown, by_direction[now])
    assert recorded.timelines == {"direction", "step"}


def test_the_text_says_how_it_ended(lab_run, hall_run):
    run, recorded = lab_run
    text = recorded.text()
    word = "".join(map(str, run.observations.tolist()))
    count = len(run.candidates)
    for phrase in ("**45°**", f"`{word}`", f"one of **{count}** cells", "## 3 knowledge cycles"):
        assert phrase in text
    assert text.count("\n| 2 (orange) | ") == 1
    assert "too many to draw" not in text
    text = hall_run[1].text()
    assert "too many to draw" in text
    assert "cycles are left out" in text


def test_a_robot_that_is_elsewhere(lab):
    """The filter is of the lab, the robot is in its mirror image."""
    there = CellSpace.of_grid(lab.cells.free[:, ::-1].copy(), 8)
    filter = lab.filter.with_trap()
    map = bounce_map(there, lab.bounce, motion=lab.motion)
    runs = [localize(map, filter, start) for start in range(there.size)]
    run = next(run for run in runs if run.states[-1] == filter.trap)
    recorded = read_back(Localized(filter, there, lab.motion, lab.bounce, run))
    text = recorded.text()
    assert "**somewhere else**" in text
    end = len(run.observations)
    assert recorded.over("step", "/filter/uncertainty", "Scalars:scalars")[end] == [0]
    assert recorded.over("step", "/map/candidates", "Boxes2D:centers")[end] == []
    assert len(recorded.poses("/map/belief")[end]) == 0


def test_a_robot_that_cannot_move():
    bounce = math.pi / 2
    cells = CellSpace.of_grid(np.ones((1, 1), bool), 4)
    map = bounce_map(cells, bounce)
    filter = localization_filter(map)
    run = localize(map, filter, 2)
    recorded = read_back(Localized(filter, cells, Motion(), bounce, run))
    assert recorded.over("step", "/filter/uncertainty", "Scalars:scalars") == {0: [4]}
    assert len(recorded.over("step", "/map/candidates", "Boxes2D:centers")[0]) == 4


@pytest.fixture(scope="module")
def adaptive(lab):
    policy = localization_policy(lab.cells, np.radians([45, 135]), motion=lab.motion)
    localization = AdaptivelyLocalized.of(policy, 151)
    return localization, read_back(localization)


def test_a_policy_shows_the_turn_at_each_bump_and_its_state(adaptive):
    localization, recorded = adaptive
    labels = recorded.over("step", "/map/turn", "Points2D:labels")
    said = [one for time in sorted(labels) for one in labels[time]]
    turns = localization.bounce_deg[localization.turned_by[localization.turned_by >= 0]]
    assert said == [f"bump {i}: turn by {turn:g}°" for i, turn in enumerate(turns, 1)]
    assert len(said) == localization.run.bumps - 1
    bumps = recorded.over("step", "/robot/bumps", "Scalars:scalars")
    assert bumps[max(bumps)] == [localization.run.bumps]
    for time, row in recorded.over("step", "/tree/graph", "GraphNodes:colors").items():
        (state,) = (i for i, color in enumerate(row) if color == packed(CURRENT))
        assert state == localization.run.states[time]
    labels = recorded.static("/tree/legend/text", "Points2D:labels")
    assert {"its trail", "the start, until the first bump"} <= set(labels)


def test_a_large_policy_is_a_tree_with_the_run(adaptive, monkeypatch):
    policy, run = adaptive[0].policy, adaptive[0].run.states.tolist()
    assert set(run) <= set(_tree(policy, run))
    small, path = 12, list(dict.fromkeys(run))
    monkeypatch.setattr("jaxcell.record.bounce.policy.MAX_DRAWN", small)
    tree = _tree(policy, run)
    assert set(path) <= set(tree)
    assert len(tree) <= max(small, len(path))
    assert tree[0] == -1
    for state, above in tree.items():
        assert above == -1 or state in policy.after(above).values()


@pytest.mark.parametrize("heading", ["known", "unknown"])
def test_a_robot_that_starts_anywhere_is_on_a_stretch_after_each_bump(heading):
    small = {"heading": heading, "robots": 1, "bumps": 8, "slices": 72, "directions": 8}
    localization = LocalizeAnywhere(map=bundled("lab_a"), bounce=(135.0,), **small).run()
    for bump, place in zip(localization.bump.tolist(), localization.trial.place[0], strict=True):
        walls = shapely.linestrings(stretches(localization, bump))
        assert shapely.distance(walls, shapely.Point(place)).min() < 1e-4
