import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from random_rooms import grids

from jaxcell import bundled
from jaxcell.automata import equivalence
from jaxcell.bounce import (
    AdaptivelyLocalized,
    bounce_map,
    localization_filter,
    localization_policy,
    localize,
)
from jaxcell.space import ENDPOINT, CellSpace
from jaxcell.verify import compare_policy


ROOMS = grids(9, (4, 5)) | grids(15, (4, 5))
LAB = CellSpace.load(bundled("lab_a"))
ANGLES = st.lists(st.integers(1, 7), min_size=1, max_size=2, unique=True)


@settings(max_examples=15)
@given(ROOMS, ANGLES, st.sampled_from(["cell", "position", "class"]), st.data())
def test_a_policy_localizes_as_far_as_its_angles_distinguish_cells(free, shifts, goal, data):
    cells = CellSpace.of_grid(free, 8)
    bounces = np.array(shifts) * math.pi / 4
    aim = data.draw(st.sampled_from(["worst", "mean"]))
    result = localization_policy(cells, bounces, goal, aim=aim)
    assert result.optimal
    assert result.least == pytest.approx(
        result.worst_bumps if aim == "worst" else result.mean_bumps
    )
    assert result.fixed_bumps >= result.worst_bumps or aim == "mean"
    mapped = bounce_map(cells, bounces)
    images, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)
    label = equivalence(images, bumped)
    assert result.classes == np.unique(label).size
    ends = [result.policy.cells(state) for state in result.policy.ends.tolist()]
    for end in ends:
        one_class = np.unique(label[end]).size == 1
        one_place = np.unique(end % cells.positions).size == 1
        assert one_class or (goal == "position" and one_place)
    if goal == "cell":
        assert result.answered == all(end.size == 1 for end in ends)
        if np.unique(label).size == cells.size:
            assert result.answered

    run = AdaptivelyLocalized.of(result, data.draw(st.integers(0, cells.size - 1)))
    assert run.run.truth_is_a_candidate
    assert run.run.bumps == run.bumps_needed.ravel()[run.run.start]
    assert all(value <= limit for value, limit in run.checks().values())
    # The cells that are left, by moving all cells one step at a time.
    left, state = np.arange(cells.size), result.policy.start()
    for time, observation in enumerate(run.run.observations.tolist()):
        np.testing.assert_array_equal(run.beliefs[time], left)
        assert state.uncertainty == left.size
        left = left[bumped[0, left] == observation]
        state = state.observe(observation)
        if not state.localized:
            left = np.unique(images[state.turn or 0, left])
    np.testing.assert_array_equal(run.run.candidates, left)
    np.testing.assert_array_equal(run.beliefs[-1], left)


@pytest.mark.parametrize(
    ("name", "worst", "mean", "fixed"), [("lab_a", 11, 970, 12), ("lab_b", 9, 680, 10)]
)
def test_two_angles_leave_one_cell_on_the_maps_of_table_2_2(name, worst, mean, fixed):
    # With one angle, the filters of these maps leave up to four cells (Alam 2018, Table 2.2).
    cells = CellSpace.load(bundled(name))
    result = localization_policy(cells, np.radians([45, 135]), motion=ENDPOINT)
    assert (result.classes, result.largest_uncertainty, result.localized_to_one) == (152, 1, 1.0)
    assert (result.worst_bumps, result.optimal, result.fixed_bumps) == (worst, True, fixed)
    for start in range(cells.size):
        run = result.drive(start)
        assert run.candidates.tolist() == [run.end]
    best = localization_policy(cells, np.radians([45, 135]), aim="mean", motion=ENDPOINT)
    assert best.optimal
    assert best.bumps_needed.sum() == mean
    assert best.mean_bumps <= result.mean_bumps


def test_a_policy_of_one_angle_remarks_that_cells_stay_indistinguishable():
    result = localization_policy(LAB, [math.radians(45)], motion=ENDPOINT)
    assert (result.classes, result.largest_uncertainty, result.answered) == (94, 4, False)
    assert "no choice" in result.remarks[0].lower()
    known = localization_policy(LAB, [math.radians(45)], "class", motion=ENDPOINT)
    assert known.answered
    assert known.worst_bumps == result.worst_bumps


def test_a_search_that_ends_at_its_limit_remarks_the_bounds():
    cut = localization_policy(LAB, np.radians([45, 135]), motion=ENDPOINT, limit=100)
    assert not cut.optimal
    assert cut.searched == 1
    assert cut.least <= 11 <= cut.worst_bumps
    assert f"needs {cut.worst_bumps} bumps at worst, and none needs less than" in cut.remarks[0]
    assert compare_policy(cut)[-1].agrees


def test_a_fixed_sequence_that_has_to_stop_early_is_remarked():
    # Two corridors at a right angle: the last turns lead robots from one place to two places.
    cells = CellSpace.of_grid(np.array([[1, 1, 1], [0, 0, 1], [0, 0, 1]], bool), 4)
    bounces = np.array([1, 2]) * math.pi / 2
    result = localization_policy(cells, bounces, "position")
    assert result.answered
    mapped = bounce_map(cells, bounces)
    images, bumped = np.asarray(mapped.image), np.asarray(mapped.bumped)
    seen = {}
    for start in range(cells.size):
        cell, observed, places = start, [], []
        for angle in (*result.fixed.inputs.tolist(), None):
            while not bumped[0, cell]:
                cell, observed = images[0, cell], [*observed, 0]
            observed = [*observed, 1]
            places.append((tuple(observed), cell % cells.positions))
            cell = cell if angle is None else images[angle, cell]
        for word, place in places:
            seen.setdefault(word, set()).add(place)
        seen.setdefault("ends", []).append([word for word, _ in places])
    ends = seen.pop("ends")
    # There is one place at some bump, and two at the end.
    assert all(min(len(seen[word]) for word in words) == 1 for words in ends)
    assert max(len(seen[words[-1]]) for words in ends) == 2
    assert "has to stop as soon as one place is left: at the end" in result.remarks[-1]
    assert not any("has to stop" in one for one in localization_policy(cells, bounces).remarks)


@given(grids(1, (4, 5)) | ROOMS, st.integers(1, 7), st.data())
def test_the_cells_left_by_a_filter_contain_the_robot(free, shift, data):
    cells = CellSpace.of_grid(free, 8)
    simple_map = bounce_map(cells, shift * math.pi / 4)
    filter = localization_filter(simple_map)
    start = data.draw(st.integers(0, cells.size - 1))
    run = localize(simple_map, filter, start)
    assert run.truth_is_a_candidate
    image, bumped = np.asarray(simple_map.image), np.asarray(simple_map.bumped)
    np.testing.assert_array_equal(run.path[1:], image[run.path[:-1]])
    np.testing.assert_array_equal(run.observations, bumped[run.path[:-1]])
    # The cells that the observations leave, from every start.
    ends = np.arange(cells.size)
    for observation in run.observations:
        ends = image[ends[bumped[ends] == observation]]
    np.testing.assert_array_equal(run.candidates, np.unique(ends))
    assert filter.run(run.observations.tolist()).localized_at == len(run.observations)


def test_another_map_is_refuted_in_the_open_world():
    here = bounce_map(CellSpace.of_grid(np.ones((3, 3), bool), 8), math.pi / 2)
    corridor = CellSpace.of_grid(np.ones((1, 9), bool), 8)
    there = bounce_map(corridor, math.pi / 2)
    filter = localization_filter(here, open_world=True)
    # Eight free steps in a row do not occur in a room of 3 x 3.
    run = localize(there, filter, int(corridor.index(0.5, 0.5)))
    assert run.states[-1] == filter.trap
    assert run.candidates.size == 0
    assert not run.truth_is_a_candidate
    assert "".join(map(str, run.observations)) == "000"


def test_a_start_that_does_not_exist_is_refused():
    simple_map = bounce_map(CellSpace.of_grid(np.ones((2, 2), bool), 4), math.pi / 2)
    with pytest.raises(ValueError, match="start: cell 16 does not exist; cells are 0 to 15"):
        localize(simple_map, localization_filter(simple_map), 16)
    policy = localization_policy(LAB, np.radians([45, 135]), limit=100)
    with pytest.raises(ValueError, match="start: cell 152 does not exist; cells are 0 to 151"):
        policy.drive(152)
