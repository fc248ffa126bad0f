"""What is right agrees with the other route, and what was altered does not."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import drift, patrol, verify
from jaxcell.bounce import (
    bounce_groups,
    bounce_map,
    coverage_policy,
    group_summary,
    localization_filter,
    plan,
    team_trajectory,
)
from jaxcell.mapping import SimpleMap
from jaxcell.markov import Arrivals
from jaxcell.patrol.map.attack import Vulnerability
from jaxcell.patrol.walks.game import strategy_game
from jaxcell.patrol.walks.graph_files import load_graph
from jaxcell.patrol.walks.measures import measure
from jaxcell.space import CellSpace, Workspace, visible_cells


pytestmark = pytest.mark.slow


DATA = Path(__file__).parents[2] / "data"
BOUNCE = math.radians(45)


def changed(array, index, value):
    """A copy with one other value."""
    array = np.array(array)
    array[index] = value
    return array


def disagreeing(found):
    wrong = [one for one in found if not one.agrees]
    assert all(one.where for one in wrong), "it says where"
    return [one.what.split(",")[0] for one in wrong]


@pytest.fixture(scope="module")
def lab():
    workspace = Workspace.load(DATA / "maps" / "lab_a.json")
    cells = CellSpace.of(workspace, workspace.cell, 8)
    mapped = bounce_map(cells, BOUNCE)
    return SimpleNamespace(cells=cells, map=mapped, groups=bounce_groups(cells, BOUNCE))


@pytest.mark.parametrize(("collision", "length"), [("swept", 1.0), ("endpoint", 1.3)])
@pytest.mark.parametrize(
    "workspace",
    [
        Workspace.load(DATA / "maps" / "lab_b.json"),
        Workspace([(0, 0), (5, 0), (6, 4), (0, 5)], [[(2, 2), (3, 2.2), (2.4, 3)]]),
    ],
)
def test_images_of_whole_maps(workspace, length, collision):
    cells = CellSpace.of(workspace, workspace.cell or 0.5, 8)
    options = {"step": length * cells.cell, "collision": collision}
    mapped = bounce_map(cells, BOUNCE, **options)
    every = np.arange(cells.size)
    found = verify.compare_images(cells, mapped, BOUNCE, **options, only=every)
    assert found.agrees, found.where
    # Steps that touch walls on both sides are left out, and they are few.
    assert found.count > 0.9 * cells.size


def test_a_wrong_image_is_found(lab):
    image, bumped = np.asarray(lab.map.image), np.asarray(lab.map.bumped)
    clear = int(np.flatnonzero(~bumped)[0])
    for wrong in (
        SimpleMap(jnp.asarray(changed(image, clear, clear)), lab.map.bumped),
        SimpleMap(lab.map.image, jnp.asarray(changed(bumped, clear, True))),
    ):
        found = verify.compare_images(lab.cells, wrong, BOUNCE)
        assert found.difference == 1
        assert found.where.startswith(f"cell {clear}:")
    assert not verify.compare_images(lab.cells, lab.map, 2 * BOUNCE).agrees


def test_groups(lab):
    image = np.asarray(lab.map.image)
    summary = group_summary(lab.cells, BOUNCE)
    right = verify.compare_groups(image, lab.groups, summary)
    assert [one.agrees for one in right] == [True, True]
    assert [one.count for one in right] == [152, 4]
    step = jnp.asarray(changed(lab.groups.step, 3, 99))
    wrong = dataclasses.replace(lab.groups, step=step)
    assert len(disagreeing(verify.compare_groups(image, wrong, summary))) == 2
    wrong = dataclasses.replace(summary, basin=jnp.asarray(changed(summary.basin, 0, 151)))
    assert disagreeing(verify.compare_groups(image, lab.groups, wrong)) == ["numbers of the groups"]


def test_filters(lab):
    filter = localization_filter(lab.map)
    assert verify.compare_filter(lab.map, filter).agrees
    assert verify.compare_filter(lab.map, filter.with_trap()).agrees
    # As if the robot did not sense one of the walls.
    wall = int(np.flatnonzero(lab.map.bumped)[0])
    deaf = SimpleMap(lab.map.image, jnp.asarray(changed(lab.map.bumped, wall, False)))
    found = verify.compare_filter(lab.map, localization_filter(deaf))
    assert not found.agrees
    assert found.where.startswith("after ")


def test_plans(lab):
    bounces = np.radians([45.0, 135.0])
    costs = (1, 100)
    plans = (plan(lab.cells, bounces, 0, goal, *costs) for goal in range(lab.cells.size))
    found = next(one for one in plans if one.changes)
    right = verify.compare_plan(lab.cells, found, bounces, *costs)
    assert not disagreeing(right)
    dear = dataclasses.replace(found, cost=found.cost + 1)
    assert len(disagreeing(verify.compare_plan(lab.cells, dear, bounces, *costs))) == 2
    lost = dataclasses.replace(found, reaching=changed(found.reaching, 5, not found.reaching[5]))
    what = ["cells that reach the goal"]
    assert disagreeing(verify.compare_plan(lab.cells, lost, bounces, *costs)) == what
    other = dataclasses.replace(found, actions=changed(found.actions, 0, 1 - found.actions[0]))
    what = ["actions of the plan"]
    assert disagreeing(verify.compare_plan(lab.cells, other, bounces, *costs)) == what


def test_coverage(lab):
    bounces, noise = np.radians([45.0, 90.0]), (BOUNCE, 0.7)
    policy = coverage_policy(lab.cells, bounces, *noise)
    right = verify.compare_coverage(lab.cells, policy, bounces, *noise)
    assert not disagreeing(right)
    far = dataclasses.replace(policy, distance=policy.distance * 1.001)
    what = ["distance of the mixture from the target"]
    assert disagreeing(verify.compare_coverage(lab.cells, far, bounces, *noise)) == what
    # The limiting distributions of another reliability.
    assert disagreeing(verify.compare_coverage(lab.cells, policy, bounces, BOUNCE, 0.6)) == [
        "what a step changes of limiting distributions"
    ]


def test_teams(lab):
    bounce = np.array([math.radians(135)])
    team = team_trajectory(lab.cells, [0, 7, 18], bounce)
    assert len(team.parts) > 1
    assert team.collisions.any()
    assert not disagreeing(verify.compare_team(lab.cells, team, bounce))
    meeting = int(np.flatnonzero(team.collisions)[0])
    for wrong, what in (
        ({"collisions": changed(team.collisions, meeting, 0)}, "steps of the robots"),
        ({"bumped": changed(team.bumped, (0, 0), not team.bumped[0, 0])}, "steps of the robots"),
        ({"covered": changed(team.covered, 1, 0)}, "positions covered"),
    ):
        altered = dataclasses.replace(team, **wrong)
        assert disagreeing(verify.compare_team(lab.cells, altered, bounce)) == [what]


def test_walks_on_a_graph():
    graph, _ = load_graph(DATA / "graphs" / "eight.json")
    measures = measure(patrol.random_walk(graph, np.ones(len(graph.edges))))
    assert not disagreeing(verify.compare_walk(measures))
    for wrong, what in (
        ({"hitting_times": 1.001 * measures.hitting_times}, "hitting times of some vertices"),
        ({"stationary": measures.stationary[::-1].copy()}, "what a step changes"),
        ({"kemeny_constant": measures.kemeny_constant + 1}, "Kemeny constant"),
        ({"entropy_rate": 0.0}, "entropy rate"),
    ):
        found = disagreeing(verify.compare_walk(dataclasses.replace(measures, **wrong)))
        assert any(one.startswith(what) for one in found), found


def test_games():
    graph, _ = load_graph(DATA / "graphs" / "line.json")
    game = strategy_game(graph)
    assert not disagreeing(verify.compare_game(game))
    other = dataclasses.replace(game.commitment, value=game.commitment.value - 0.01)
    wrong = dataclasses.replace(game, commitment=other)
    assert disagreeing(verify.compare_game(wrong)) == ["value of the game"]


def test_patrols_of_a_map():
    workspace = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    cells = CellSpace.of(workspace, 1.0, 1)
    graph, reach = patrol.cell_graph(cells), 2.0
    visible = visible_cells(cells, reach)
    policies = patrol.distributed_policies(graph, visible, 2)
    times = np.array([2, 5], np.int32)
    capture = patrol.capture_probabilities(graph, visible, policies, times)
    runs = 400
    attack = Vulnerability(
        target=0,
        view=visible[0],
        boundary=visible[0],
        attack_times=times,
        exact=capture[:, 0],
        simulated=capture[:, 0] + 2 * np.sqrt(capture[:, 0] * (1 - capture[:, 0]) / runs),
        fitted=np.full(2, np.nan),
        law=np.zeros(6),
        arrivals=Arrivals(jnp.zeros(runs), 1),
        fit=None,
        failure="not asked for",
    )

    right = patrol.PatrolledMap(cells, reach, graph, visible, policies, attack, capture)

    def compare(**other):
        return disagreeing(verify.compare_patrolled_map(dataclasses.replace(right, **other)))

    assert compare() == []
    assert compare(capture=0.999 * capture) == ["capture of some cells"]
    hidden = np.argwhere(~visible)[0]
    assert "cells that are seen" in compare(visible=changed(visible, tuple(hidden), True))
    slow = tuple(dataclasses.replace(one, commute_time=one.commute_time + 1) for one in policies)
    assert compare(policies=slow) == ["commute times of the robots"]
    other = dataclasses.replace(attack, simulated=attack.simulated - 0.5)
    assert compare(attack=other) == ["capture of the target"]


@pytest.mark.parametrize(
    ("spread", "edge"),
    [
        ("turned", "uniform"),
        ("turned", "exit"),
        ("all", "exit"),
        ("all", "uniform"),
        ("sampled", "exit"),
    ],
)
def test_drifters(spread, edge):
    currents = drift.open_currents(DATA / "ocean" / "gyres.nc").isel(layer=slice(2, 3))
    water, flow = drift.Water.of(currents), drift.Flow.of(currents).mean()
    options = {"rho": 0.8, "spread": spread, "edge": edge}
    chain = drift.drift_map(water, flow, 3400.0, **options)
    behaviour = drift.long_term_behaviour(chain, 3400.0)
    ends = behaviour.probability if behaviour.groups.count else None
    deployment = drift.deployment_cells(behaviour)

    def compare(**other):
        values = {"behaviours": [behaviour], "ends": [ends], "deployment": deployment, **other}
        return verify.compare_drift(currents, [water], **values, **options)

    assert disagreeing(compare()) == []
    if spread != "turned":
        return
    slow = dataclasses.replace(behaviour.absorption, value=1.01 * behaviour.absorption.value)
    altered = dataclasses.replace(behaviour, absorption=slow)
    (what,) = disagreeing(compare(behaviours=[altered]))
    assert what.startswith("times until")
    groups = dataclasses.replace(behaviour.groups, group=jnp.roll(behaviour.groups.group, 1))
    altered = dataclasses.replace(behaviour, groups=groups)
    assert any(
        one.startswith("persistent groups") for one in disagreeing(compare(behaviours=[altered]))
    )
    few = drift.Deployment(*(part[:1] for part in vars(deployment).values()))
    assert disagreeing(compare(deployment=few)) == ["cells visited from the deployment"]
    wrong = {**options, "rho": 0.81}
    found = verify.compare_drift(currents, [water], [behaviour], [ends], deployment, **wrong)
    (what,) = disagreeing(found)
    assert what.startswith("images of cells")


def test_what_is_no_number_does_not_agree():
    assert not verify.Comparison.close("x", [np.nan], [1.0], 1.0).agrees
    assert not verify.Comparison.close("x", [np.inf], [1.0], 1.0, relative=True).agrees
    assert verify.Comparison.close("x", [np.inf, 0.0], [np.inf, 0.0], 0.0, relative=True).agrees
    assert verify.Comparison.close("x", [np.nan], [1.0], 1.0).as_json()["difference"] is None
