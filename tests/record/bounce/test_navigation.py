import itertools

import numpy as np
import pytest
from recordings import packed, poses_of, read_back

from jaxcell.bounce import all_plans, plan
from jaxcell.record import dataset
from jaxcell.record.canvas.palette import TRAIL
from jaxcell.space import CellSpace


BOUNCES = np.deg2rad([45, 90, 135])


@pytest.fixture(scope="module")
def cells():
    free = np.ones((9, 13), bool)
    free[2:4, 3:6] = free[6:8, 8:10] = False
    return CellSpace.of_grid(free, 8, cell=0.5, origin=(-1.0, 2.0))


@pytest.fixture(scope="module")
def planned(cells):
    """A plan that begins with a step, changes its angle, and bumps twice in a place."""
    made = plan(cells, BOUNCES, 164, 37)
    assert made.changes
    assert (np.diff(np.flatnonzero(made.actions)) == 1).any()
    assert made.actions[0] == 0
    return made


@pytest.fixture(scope="module")
def recorded(cells, planned):
    return read_back(planned, {"bounce_deg": [45, 90, 135]})


@pytest.fixture(scope="module")
def split():
    """Two rooms that have no way between them, and a plan to try it."""
    cells = CellSpace.of_grid(np.array([[1, 1, 1, 0, 1, 1]] * 3, bool), 24)
    return plan(cells, BOUNCES, 0, cells.size - 1)


def test_the_dataset_says_that_there_is_no_path(split):
    data = dataset(split)
    assert data.cost == -1
    assert data.sizes["move"] == 0
    assert data["visited"].values.tolist() == [0]
    assert data.reaches.values.sum() == split.reaching.sum() > 0


def test_runs_are_arrows_in_the_colours_of_their_angles(cells, planned, recorded):
    x, y, _ = cells.centre(planned.visited)
    origins = np.array(recorded.static("/map/plan/runs", "Arrows2D:origins"))
    vectors = np.array(recorded.static("/map/plan/runs", "Arrows2D:vectors"))
    colors = recorded.static("/map/plan/runs", "Arrows2D:colors")
    expected, colored, began, turn = [], [], 0, None
    for time, action in enumerate([*planned.actions.tolist(), -1.0]):
        if action != 0:
            if time > began:
                expected.append((x[began], y[began], x[time] - x[began], y[time] - y[began]))
                colored.append(turn)
            began, turn = time + 1, action
    expected = np.array(expected)
    np.testing.assert_allclose(origins, expected[:, :2])
    length = np.linalg.norm(expected[:, 2:], axis=1, keepdims=True)
    drawn = np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(vectors / drawn, expected[:, 2:] / length, atol=1e-6)
    assert ((drawn < length) & (drawn > length - cells.cell)).all()
    assert len(set(colors)) == len(set(colored)) == len(dict(zip(colored, colors, strict=True)))
    assert colors[0] == packed(TRAIL)


def test_bumps_are_marked_and_told(cells, planned, recorded):
    bumps = np.flatnonzero(planned.actions != 0)
    places = np.array(recorded.static("/map/plan/bumps", "Points2D:positions"))
    np.testing.assert_allclose(places, poses_of(cells, planned.visited[bumps])[:, :2])
    colors = recorded.static("/map/plan/bumps", "Points2D:colors")
    pairs = set(zip(planned.turns.tolist(), colors, strict=True))
    assert len(pairs) == planned.angles_used == len({color for _, color in pairs})
    radii = recorded.static("/map/plan/bumps", "Points2D:radii")
    for i, j in itertools.pairwise(bumps):
        if j == i + 1:
            first, second = (radii[np.searchsorted(bumps, k)] for k in (i, j))
            assert second < first, "the second dot hides the first"
    labels = recorded.over("step", "/map/turn", "Points2D:labels")
    for time, action in enumerate(planned.actions):
        if action:
            (label,) = labels[time]
            assert label.endswith(f"turn by {np.rad2deg(action):g}°")
        else:
            assert not labels[time]


def test_start_and_goal_are_marked(cells, planned, recorded):
    for name, cell in (("start", planned.start), ("goal", planned.goal)):
        x, y, theta = cells.centre(cell)
        centre = recorded.static(f"/map/{name}/frame", "Boxes2D:centers")
        np.testing.assert_allclose(centre, [(x, y)])
        assert recorded.static(f"/map/{name}/label", "Points2D:labels") == [name]
        ((dx, dy),) = recorded.static(f"/map/{name}/heading", "Arrows2D:vectors")
        np.testing.assert_allclose(np.exp(1j * np.arctan2(dy, dx)), np.exp(1j * theta), atol=1e-6)


def test_the_pictures_show_from_where_the_goal_is_reached(cells, planned, recorded):
    reaches = planned.reaching.reshape(cells.directions, -1)
    heat = recorded.labels("/map/grid/heat")
    labels = [f"from {n} of 8 headings" if n else "from no heading" for n in reaches.sum(axis=0)]
    assert heat[cells.free].tolist() == labels
    assert (heat[~cells.free] == "not free").all()
    pictures = recorded.labels("/map/grid/heading", "direction")
    shown = np.stack([pictures[k][cells.free] for k in range(cells.directions)])
    np.testing.assert_array_equal(shown, np.where(reaches, "from here", "not from here"))
    # On the way, the picture is that of the heading of the robot.
    headings = planned.visited // cells.positions
    on_the_way = recorded.labels("/map/grid/heading", "step")
    assert list(on_the_way) == [0, *(1 + np.flatnonzero(np.diff(headings))).tolist()]
    for time, picture in on_the_way.items():
        np.testing.assert_array_equal(picture, pictures[headings[time]])


def test_without_a_path_there_is_a_heat_map(split):
    recorded = read_back(split)
    assert "direction" in recorded.timelines
    assert "step" not in recorded.timelines
    assert not [entity for entity in recorded.entities if entity.startswith("/map/plan")]
    classes = recorded.classes("/map/grid/heat")
    assert classes[2] == "from 1 to 3 of 24 headings"
    assert len(classes) == 2 + 8
    reaching = split.reaching.reshape(24, -1).sum(axis=0)
    shown = recorded.picture("/map/grid/heat").ravel()[split.cells.square]
    np.testing.assert_array_equal(shown, 1 + -(-reaching // 3))
    text = recorded.text()
    assert "There is no path" in text


def test_the_text_tells_the_plan(planned, recorded):
    text = recorded.text()
    assert f"cost **{planned.cost}**" in text
    word = text.split("`")[1]
    actions = []
    for part in word.split(", "):
        count, _, unit = part.partition(" ")
        actions += [0.0] * int(count) if unit else [np.deg2rad(float(part.rstrip("°")))]
    np.testing.assert_allclose(actions, planned.actions)
    assert "bounce_deg" in text


@pytest.mark.parametrize("goal", [5, 0])
def test_short_plans_are_recorded(cells, goal):
    made = plan(cells, BOUNCES, 0, goal)
    assert made.bumps == 0
    recorded = read_back(made)
    assert len(recorded.over("step", "/map/robot", "Arrows2D:origins")) == goal + 1
    text = recorded.text()
    assert "| bumps | 0 |" in text
    assert ("starts at the goal" in text) == (goal == 0)


def test_the_costs_of_all_plans_have_the_costliest(cells):
    plans = all_plans(cells, BOUNCES)
    costs = plans.cost_summary()
    known = plans.costs()
    assert costs.largest_cost == costs.costliest.cost == known.max()
    assert costs.mean_cost == pytest.approx(known[known >= 0].mean())
    assert costs.reachable_pairs == pytest.approx((known >= 0).mean())
    data = dataset(costs)
    assert data.costliest_visited.values.tolist() == costs.costliest.visited.tolist()
    text = read_back(costs).text()
    assert f"cost **{known.max()}**" in text
