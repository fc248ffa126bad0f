import numpy as np
import pytest
from recordings import packed, read_back

from jaxcell.bounce import AdaptivelyLocalized, localization_policy
from jaxcell.record.bounce.policy import _tree
from jaxcell.record.canvas.palette import CURRENT


@pytest.fixture(scope="module")
def found(lab):
    policy = localization_policy(lab.cells, np.radians([45, 135]), motion=lab.motion)
    return AdaptivelyLocalized.of(policy, 151)


@pytest.fixture(scope="module")
def recorded(found):
    return read_back(found)


def test_shows_the_belief_and_the_turn_at_each_bump(found, recorded):
    arrows = recorded.over("step", "/map/belief", "Arrows2D:origins")
    assert [len(arrows[time]) for time in range(len(found.beliefs))] == found.belief_size.tolist()
    labels = recorded.over("step", "/map/turn", "Points2D:labels")
    said = [one for time in sorted(labels) for one in labels[time]]
    turns = found.bounce_deg[found.turned_by[found.turned_by >= 0]]
    assert said == [f"bump {i}: turn by {turn:g}°" for i, turn in enumerate(turns, 1)]
    assert len(said) == found.run.bumps - 1
    bumps = recorded.over("step", "/robot/bumps", "Scalars:scalars")
    assert bumps[max(bumps)] == [found.run.bumps]


def test_lights_up_one_state_at_a_time(found, recorded):
    colors = recorded.over("step", "/tree/graph", "GraphNodes:colors")
    for time, row in colors.items():
        (state,) = (i for i, color in enumerate(row) if color == packed(CURRENT))
        assert state == found.run.states[time]


def test_a_large_policy_is_a_tree_with_the_run(found):
    tree = _tree(found.policy, run := found.run.states.tolist())
    assert set(run) <= set(tree)
    small, path = 12, list(dict.fromkeys(run))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.record.bounce.policy.MAX_DRAWN", small)
        tree = _tree(found.policy, run)
    assert set(path) <= set(tree)
    assert len(tree) <= max(small, len(path))
    assert tree[0] == -1
    for state, above in tree.items():
        assert above == -1 or state in found.policy.after(above).values()


def test_the_legend_names_both_greys(recorded):
    labels = recorded.static("/tree/legend/text", "Points2D:labels")
    assert {"its trail", "the start, until the first bump"} <= set(labels)
