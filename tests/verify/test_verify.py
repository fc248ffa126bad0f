"""Correct results agree with independent computations, and altered results do not."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import drift, patrol, verify
from jaxcell.bounce import (
    BounceGroups,
    LocalizationFilter,
    bounce_map,
    coverage_policy,
    localization_filter,
    plan,
)
from jaxcell.mapping import SimpleMap
from jaxcell.markov import Arrivals
from jaxcell.optimize import Graph, Linear, minimum_commute
from jaxcell.patrol.files.graph_files import load_graph
from jaxcell.patrol.map.attacked_cell import Vulnerability
from jaxcell.patrol.walks.game import strategy_game
from jaxcell.space import CellSpace, Motion, Workspace, visible_cells


DATA = Path(__file__).parents[2] / "data"
BOUNCE = math.radians(45)


def changed(array, index, value):
    """Copy an array with a changed value."""
    array = np.array(array)
    array[index] = value
    return array


def disagreeing(result):
    wrong = [one for one in result if not one.agrees]
    assert all(one.where for one in wrong), "each has the place of its difference"
    return [one.what.split(",")[0] for one in wrong]


def check(compare, right, *alterations):
    """Check that a result agrees, and where it disagrees with altered fields or cached values."""
    assert not disagreeing(compare(right))
    for fields, *what in alterations:
        other = dataclasses.replace(right)
        other.__dict__.update(fields)
        assert disagreeing(compare(other)) == what


@pytest.fixture(scope="module")
def lab():
    workspace = Workspace.load(DATA / "maps" / "lab_a.json")
    cells = CellSpace.of(workspace, workspace.cell, 8)
    mapped = bounce_map(cells, BOUNCE)
    return SimpleNamespace(cells=cells, map=mapped)


@pytest.mark.parametrize(("collision", "length"), [("swept", 1.0), ("endpoint", 1.3)])
@pytest.mark.parametrize(
    "workspace",
    [
        Workspace.load(DATA / "maps" / "lab_b.json"),
        Workspace([(0, 0), (5, 0), (6, 4), (0, 5)], [[(2, 2), (3, 2.2), (2.4, 3)]]),
    ],
)
def test_right_images_of_whole_maps_agree(workspace, length, collision):
    cells = CellSpace.of(workspace, workspace.cell or 0.5, 8)
    options = {"motion": Motion(length * cells.cell, collision)}
    mapped = bounce_map(cells, BOUNCE, **options)
    every = np.arange(cells.size)
    result = verify.compare_images(cells, mapped, BOUNCE, **options, only=every)
    assert result.agrees, result.where
    # The few steps that touch walls on both sides are left out.
    assert result.count > 0.9 * cells.size


def test_a_wrong_image_is_found(lab):
    image, bumped = np.asarray(lab.map.image), np.asarray(lab.map.bumped)
    clear = int(np.flatnonzero(~bumped)[0])
    for wrong in (
        SimpleMap(jnp.asarray(changed(image, clear, clear)), lab.map.bumped),
        SimpleMap(lab.map.image, jnp.asarray(changed(bumped, clear, True))),
    ):
        result = verify.compare_images(lab.cells, wrong, BOUNCE)
        assert result.difference == 1
        assert result.where.startswith(f"cell {clear}:")
    assert not verify.compare_images(lab.cells, lab.map, 2 * BOUNCE).agrees


def test_altered_groups_do_not_agree(lab):
    result = BounceGroups.of(lab.cells, BOUNCE)
    assert [one.count for one in verify.compare_groups(result)] == [152, 456, 6]
    check(
        verify.compare_groups,
        result,
        ({"step": changed(result.step, (0, 0, 3), 99)}, "groups of cells"),
        ({"largest_basin": np.array([151])}, "numbers of the groups"),
    )


def test_altered_filters_do_not_agree(lab):
    filter = localization_filter(lab.map)
    for one in (filter, filter.with_trap()):
        assert not disagreeing(verify.compare_filter(LocalizationFilter(one), lab.map))
    # As if the robot did not sense one of the walls.
    wall = int(np.flatnonzero(lab.map.bumped)[0])
    deaf = SimpleMap(lab.map.image, jnp.asarray(changed(lab.map.bumped, wall, False)))
    result = LocalizationFilter(localization_filter(deaf))
    assert disagreeing(verify.compare_filter(result, lab.map)) == ["states of the filter"]
    altered = dataclasses.replace(filter)
    altered.__dict__["color"] = changed(filter.color, 0, 2)
    result = verify.compare_filter(LocalizationFilter(altered), lab.map)
    assert disagreeing(result) == ["knowledge cycles"]


def test_altered_plans_do_not_agree(lab):
    bounces = np.radians([45.0, 135.0])
    costs = (1, 100)
    plans = (plan(lab.cells, bounces, 0, goal, *costs) for goal in range(lab.cells.size))
    result = next(one for one in plans if one.changes)
    dear = {"cost": result.cost + 1}
    lost = {"reaching": changed(result.reaching, 5, not result.reaching[5])}
    altered = (dear, "cost of the plan"), (lost, "cells that reach the goal")
    check(verify.compare_plan, result, *altered)
    assert dataclasses.replace(result, **dear).checks()["cost_minus_that_of_actions"][0] == 1
    other = dataclasses.replace(result, actions=changed(result.actions, 0, 1 - result.actions[0]))
    assert other.checks()["actions_that_lead_elsewhere"][0] > 0


def test_altered_coverage_does_not_agree(lab):
    bounces, noise = np.radians([45.0, 90.0]), (BOUNCE, 0.7)
    policy = coverage_policy(lab.cells, bounces, *noise)
    far = {"distance": policy.distance * 1.001}, "distance of the mixture from the target"
    check(lambda policy: verify.compare_coverage(policy, *noise), policy, far)
    # The limiting distributions of another reliability.
    assert disagreeing(verify.compare_coverage(policy, BOUNCE, 0.6)) == [
        "change of limiting distributions by a step"
    ]


def test_altered_walks_on_a_graph_do_not_agree():
    graph, _ = load_graph(DATA / "graphs" / "eight.json")
    walk = patrol.GraphPatrol.of(graph, patrol.random_walk(graph, np.ones(len(graph.edges))))
    hitting, shares = "hitting times of some vertices", "shares of time after a step"
    check(
        verify.compare_walk,
        walk,
        ({"hitting_time": 1.001 * walk.hitting_time}, hitting, "Kemeny constant"),
        ({"stationary": walk.stationary[::-1].copy()}, shares, "entropy rate", "Kemeny constant"),
        ({"kemeny_constant": walk.kemeny_constant + 1}, "Kemeny constant"),
        ({"entropy_rate_nats": 0.0}, "entropy rate"),
    )


@pytest.mark.parametrize(
    ("name", "emphasis", "cap"), [("line", (), 1), ("eight", (1, 4), 1), ("eight", (), 0.09)]
)
def test_commute_times_that_are_not_least_do_not_agree(name, emphasis, cap):
    graph, _ = load_graph(DATA / "graphs" / f"{name}.json")
    rules = [Linear(str(i), row, upper=cap) for i, row in enumerate(np.eye(len(graph.edges)))]
    best = minimum_commute(graph, emphasis or None, 0.9, constraints=rules).weights
    walk = patrol.GraphPatrol.of(graph, patrol.random_walk(graph, best))
    assert not disagreeing(verify.compare_commute(walk, emphasis, 0.9, rules))
    other = patrol.GraphPatrol.of(graph, patrol.random_walk(graph, best + 0.01))
    wrong = disagreeing(verify.compare_commute(other, emphasis, 0.9, rules))
    assert wrong[0] == "least commute time"
    # More even weights still satisfy the caps.
    assert wrong[1:] == ["violation of constraints"] * bool(emphasis)


def test_the_least_commute_time_of_a_long_line_agrees():
    graph = Graph([[i, i + 1] for i in range(61)])
    walk = patrol.GraphPatrol.of(graph, patrol.random_walk(graph, minimum_commute(graph).weights))
    assert not disagreeing(verify.compare_commute(walk, (), 0.9))


def test_altered_games_do_not_agree():
    graph, _ = load_graph(DATA / "graphs" / "line.json")
    game = strategy_game(graph)
    other = dataclasses.replace(game.commitment, value=game.commitment.value - 0.01)
    check(verify.compare_game, game, ({"commitment": other}, "value of the game"))


def test_altered_patrols_of_a_map_do_not_agree():
    workspace = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)], [[(1, 1), (2, 1), (2, 2), (1, 2)]])
    cells = CellSpace.of(workspace, 1.0, 1)
    graph, reach = patrol.cell_graph(cells), 2.0
    visible = visible_cells(cells, reach)
    policies = patrol.distributed_policies(graph, visible, 2)
    times = np.array([2, 5], np.int32)
    caught = patrol.Capture.of(graph, visible, policies, patrol.Attack(times))
    capture = caught.probability
    runs = 400
    attack = Vulnerability(
        target=0,
        view=visible[0],
        boundary=visible[0],
        attack_time=times,
        exact=capture[:, 0],
        simulated=capture[:, 0] + 2 * np.sqrt(capture[:, 0] * (1 - capture[:, 0]) / runs),
        fitted=np.full(2, np.nan),
        law=np.zeros(6),
        arrivals=Arrivals(jnp.zeros(runs), 1),
        fit=None,
        failure="not asked for",
    )

    right = patrol.PatrolledMap(cells, reach, graph, visible, policies, attack, caught)

    seen = changed(visible, tuple(np.argwhere(~visible)[0]), True)
    slow = tuple(dataclasses.replace(one, commute_time=one.commute_time + 1) for one in policies)
    # An obstacle is between cells 4 and 5.
    through = Graph(changed(graph.edges, 0, (4, 5)), xy=graph.xy)
    other = dataclasses.replace(attack, simulated=attack.simulated - 0.5)
    check(
        verify.compare_patrolled_map,
        right,
        ({"visible": seen}, "cells that are seen"),
        ({"policies": slow}, "commute times of the robots"),
        ({"graph": through}, "steps through walls", "commute times of the robots"),
        ({"attack": other}, "capture of the target"),
    )


@pytest.mark.parametrize("edge", ["uniform", "exit"])
def test_altered_drifters_do_not_agree(edge):
    # In the changing current, some drifters stay almost forever, and no solve is certified.
    currents = drift.open_currents(DATA / "ocean" / "gyres.nc", time=0).isel(layer=slice(2, 3))
    result = drift.SeaDrift.of(currents, drift.DriftStep(3400.0, edge=edge), start=0).towards(100)
    (layer,) = result.layers
    behaviour = layer.behaviour

    def compare(**fields):
        changed = dataclasses.replace(behaviour, **fields)
        other = dataclasses.replace(layer, behaviour=changed)
        return disagreeing(verify.compare_drift(dataclasses.replace(result, layers=(other,))))

    slow = dataclasses.replace(behaviour.absorption, value=1.01 * behaviour.absorption.value)
    (what,) = compare(absorption=slow)
    assert what.startswith("times until")
    groups = dataclasses.replace(behaviour.groups, group=jnp.roll(behaviour.groups.group, 1))
    assert any(one.startswith("persistent groups") for one in compare(groups=groups))
    few = drift.Deployment(*(part[:1] for part in vars(result.deployment).values()))
    policy = result.surest.policy
    worse = dataclasses.replace(policy, probability=0.99 * policy.probability)
    surest = dataclasses.replace(result.surest, policy=worse)
    check(
        verify.compare_drift,
        result,
        ({"deployment": few}, "cells visited from the deployment"),
        ({"surest": surest}, "probability of arriving by the surest policy"),
    )


def test_a_difference_that_is_no_number_does_not_agree():
    assert not verify.Comparison.close("x", [np.nan], [1.0], 1.0).agrees
    assert not verify.Comparison.close("x", [np.inf], [1.0], 1.0, relative=True).agrees
    assert verify.Comparison.close("x", [np.inf, 0.0], [np.inf, 0.0], 0.0, relative=True).agrees
    assert verify.Comparison.close("x", [np.nan], [1.0], 1.0).as_json()["difference"] is None
