"""Results check themselves, and each check sees its kind of damage."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from changed_results import changed

from jaxcell.bounce import TeamOutcome, TeamTrajectory, plan
from jaxcell.record import dataset
from jaxcell.space import CellSpace


def failing(checks):
    return {name for name, (value, limit) in checks.items() if not value <= limit}


def put(index, value):
    """A function that changes one element of an array."""

    def change(array):
        array = np.array(array)
        assert array[index] != value
        array[index] = value
        return array

    return change


def even_shares(laws):
    """Laws that share the time evenly among all cells, also among transient cells."""
    return tuple(
        dataclasses.replace(one, value=jnp.full_like(one.value, 1 / one.value.size)) for one in laws
    )


@pytest.fixture(scope="module")
def localized(lab):
    return lab.localized(100)


@pytest.fixture(scope="module")
def turn():
    """Three positions in a row, East and West: one step and a turn."""
    return plan(CellSpace.of_grid(np.ones((1, 3), bool), 2), [np.pi], 1, 5)


@pytest.fixture(scope="module")
def turned():
    """Three positions, East and West: robot 0 goes on, 1 bumps, and then 1 is turned."""
    return TeamTrajectory(
        cells=CellSpace.of_grid(np.ones((1, 3), bool), 2),
        bumped=np.array([[False, True], [False, False]]),
        collided=np.zeros((2, 2), bool),
        collisions=np.zeros(2, np.int32),
        cell=np.array([[0, 2], [1, 5], [1, 2]], np.int32),
        covered=np.array([2, 3, 3], np.int32),
        part_begin=np.array([0, 2], np.int32),
        uncovered_positions=np.empty(0, np.int32),
        outcome=TeamOutcome.COVERED,
    )


@pytest.mark.parametrize(
    ("result", "name", "change", "check"),
    [
        ("angles", "group_basin", put((0, 0), 1), "basins_minus_cells"),
        ("angles", "group_period", put((0, 0), 1), "periodic_cells_minus_period"),
        ("angles", "group_transient", put((0, 0), 99), "steps_that_no_cell_takes"),
        ("angles", "group", put((0, 0, 0), 1), "image_violations"),
        ("angles", "longest_period", put(0, 1), "numbers_not_those_of_cells"),
        ("localized", "uncertainty", put(0, 151), "uncertainty_minus_members"),
        ("localized", "transition", put((1, 0), 0), "states_that_gain_cells"),
        ("localized", "run.states", put(1, 0), "run_off_the_transitions"),
        ("localized", "run.candidates", put(0, 0), "candidates_not_of_the_last_state"),
        ("policy", "limiting", even_shares, "share_of_transient_cells"),
        ("policy", "alpha", lambda alpha: alpha / 2, "alpha_sums_to_1"),
        ("policy", "mixture", lambda mixture: mixture[::-1], "mixture_is_of_coverage"),
        ("policy", "coverage", lambda coverage: coverage[:, ::-1], "coverage_is_of_share"),
        ("policy", "target", lambda target: target - 1, "target_out_of_0_to_1"),
        ("turn", "visited", put(1, 0), "actions_that_lead_elsewhere"),
        ("turn", "actions", put(1, np.pi / 2), "actions_that_lead_elsewhere"),
        ("turn", "goal", lambda _: 4, "ends_missed"),
        ("turn", "reaching", lambda _: np.arange(6) < 3, "cells_that_do_not_reach"),
        ("turn", "cost", lambda _: 101, "cost_minus_that_of_actions"),
        ("turn", "start", lambda _: 6, "start_not_of_the_map"),
        ("turned", "cell", put((1, 0), 2), "shared_positions"),
        ("turned", "cell", put((2, 1), 5), "parts_that_begin_otherwise"),
        ("turned", "bumped", put((0, 0), True), "moves_against_the_rule"),
        ("turned", "covered", put(1, 2), "covered_minus_visited"),
        (
            "turned",
            "uncovered_positions",
            lambda _: np.array([19], np.int32),
            "uncovered_positions_not_of_the_map",
        ),
    ],
)
def test_a_result_that_contradicts_itself_is_refused(request, result, name, change, check):
    result = request.getfixturevalue(result)
    assert not failing(result.checks())
    dataset(result)
    wrong = changed(result, name, change)
    with pytest.raises(RuntimeError, match="the result contradicts itself") as refusal:
        dataset(wrong)
    # The refusal names the first of several checks that fail.
    assert f"{check} is " in str(refusal.value) or check in failing(wrong.checks())


def test_a_robot_may_be_lost_if_the_filter_is_of_another_map(localized):
    lost = changed(localized, "run.path", put(-1, 0))
    assert not failing(lost.checks())
    assert lost.checks()["states_without_the_robot"][0] == 1
