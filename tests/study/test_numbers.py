"""Numbers of many studies at once are those of each alone."""

import dataclasses

import numpy as np
import pytest

from jaxcell import bundled
from jaxcell.bounce import noisy_bounce_map
from jaxcell.study import Cover, Dynamics, Escape, Groups, Rooms
from jaxcell.sweep.study_task import read_study, study_task


def columns_of(*args):
    """The columns of the task of a study, by name."""
    return {name: column for name, (_, column, _) in study_task(*args).items()}


def alone(study, columns):
    """The numbers of each study, which runs by itself with one value of each parameter."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    members = (dict(zip(columns, row, strict=True)) for row in rows)
    several = ({k: (v,) if k == "bounce" else v for k, v in one.items()} for one in members)
    return [dataclasses.replace(study, **one).run() for one in several]


SMALL = Rooms(room=0, bounce=(45.0,), columns=9, rows=7, obstacles=2, directions=8)


@pytest.mark.parametrize(
    "columns",
    [
        {"room": np.repeat(np.arange(5), 3), "bounce": np.tile([45.0, 90.0, 315.0], 5)},
        # Each room has an angle of its own.
        {"room": np.array([3, 1, 2, 1]), "bounce": np.array([90.0, 45.0, 135.0, 45.0])},
        {"room": np.array([4, 4, 0])},
    ],
    ids=["product", "scattered", "one_angle"],
)
def test_rooms(columns):
    numbers = SMALL.numbers(columns)
    assert set(numbers) >= {"count", "longest_period", "filter_states", "positions"}
    for i, result in enumerate(alone(SMALL, columns)):
        for name, (_, column) in numbers.items():
            assert column[i] == np.ravel(getattr(result, name))[0]


def test_groups():
    study = Groups(map=bundled("lab_a"), bounce=(0.0,))
    columns = {"bounce": np.array([90.0, 45.0, 90.0])}
    numbers = study.numbers(columns)
    for i, result in enumerate(alone(study, columns)):
        assert {name: column[i] for name, (_, column) in numbers.items()} == {
            name: getattr(result, name)[0] for name in numbers
        }


SLOPES = [f"d_{name}_d_reliability" for name in ("distance", "goal_share", "goal_time")]
COVER = {"map": str(bundled("lab_a")), "directions": 8, "bounce": [45, 90, 135]}


@pytest.mark.parametrize(
    "batch",
    [
        {"reliability": np.tile([0.6, 0.8, 1.0], 2), "errors_turn": np.repeat([45, 90], 3)},
        # Each angle has several reliabilities; a sure turn has other possible steps.
        {"bounce": np.array([45, 90, 45, 45]), "reliability": np.array([0.9, 0.7, 0.8, 1.0])},
    ],
    ids=["product", "scattered"],
)
@pytest.mark.parametrize("weights", ["basin", "size"])
def test_cover(batch, weights):
    fixed = {**COVER, "weights": weights, "errors_turn": 45, "goal": "7.5,1.5,1.2"}
    table = columns_of(Cover, batch, {k: v for k, v in fixed.items() if k not in batch}, 0)
    assert set(table) >= {"distance", "angles_used", "duality_gap", "goal_share", "goal_time"}
    for i in range(len(batch["reliability"])):
        one = {name: column[i].item() for name, column in batch.items()}
        result = read_study(Cover, {**fixed, **one}).run()
        for name, column in table.items():
            assert column[i] == pytest.approx(getattr(result, name), rel=1e-10, abs=1e-12)


def test_cover_agrees_with_dense_linear_algebra():
    fixed = {**COVER, "bounce": 90, "errors_turn": 45, "reliability": 0.8, "goal": "7.5,1.5"}
    study = read_study(Cover, fixed)
    reliability = np.array([0.5, 0.75, 0.9])
    wanted = {"distance", "goal_share", "goal_time", *SLOPES}
    found = study.numbers({"reliability": reliability}, wanted.__contains__)
    assert found.keys() == wanted
    assert found["d_goal_time_d_reliability"][0].units == "steps"
    cells = study.cells()
    x, y, _ = cells.centre(np.arange(cells.size))
    goal = np.hypot(x - 7.5, y - 1.5) <= 1
    assert goal.sum() == 3 * 8

    def dense(one):
        steps = noisy_bounce_map(cells, np.pi / 2, np.pi / 4, one).to_scipy().toarray()
        long = np.linalg.matrix_power((steps + np.eye(cells.size)) / 2, 2**20)
        share = long.mean(axis=0).reshape(8, -1).sum(axis=0)
        among = np.eye((~goal).sum()) - steps[~goal][:, ~goal]
        times = np.linalg.solve(among, np.ones(len(among)))
        distance = np.linalg.norm(share - 1 / share.size)
        return np.array([distance, share[goal[: share.size]].sum(), times.sum() / cells.size])

    for i, one in enumerate(reliability.tolist()):
        values = [found[name][1][i] for name in ("distance", "goal_share", "goal_time")]
        np.testing.assert_allclose(values, dense(one), rtol=1e-8)
        slopes = (dense(one + 1e-4) - dense(one - 1e-4)) / 2e-4
        np.testing.assert_allclose([found[name][1][i] for name in SLOPES], slopes, rtol=1e-5)


def test_single_member_has_derivatives_that_are_wanted():
    fixed = {**COVER, "errors_turn": 45, "goal": "7.5,1.5"}
    batch = {"reliability": np.array([0.6, 0.8])}
    several = columns_of(Cover, batch, fixed, 0, SLOPES)
    alone = columns_of(Cover, {"reliability": np.array([0.8])}, fixed, 0, SLOPES)
    for name in SLOPES:
        assert several[name].item(1) == pytest.approx(alone[name].item(0), rel=1e-8)
    names = ["distance", *SLOPES]
    # At a sure turn the numbers may jump, so they have no derivative there.
    for values in ([1, 1], [0.8, 1.0, 0.9]):
        sure = columns_of(Cover, {"reliability": np.array(values)}, fixed, 0, names)
        assert np.isfinite(sure["distance"]).all()
        for name in SLOPES:
            assert (np.isnan(sure[name]) == (np.array(values) == 1)).all()
    with pytest.raises(ValueError, match="no number 'd_angles_used_d_reliability'"):
        columns_of(Cover, batch, fixed, 0, ["d_angles_used_d_reliability"])


def test_numbers_of_a_member_do_not_depend_on_the_others():
    study = read_study(Cover, {**COVER, "errors_turn": 45, "reliability": 0.8, "goal": "7.5,1.5"})
    reliability = np.append(np.linspace(0.3, 0.99, 18), [1.0, 0.8])
    wanted = {"distance", "goal_share", "goal_time", "duality_gap", *SLOPES}

    def run(members):
        found = study.numbers({"reliability": reliability[members]}, wanted.__contains__)
        return {name: column for name, (_, column) in found.items()}

    whole = run(np.arange(20))
    shuffled = np.random.default_rng(0).permutation(20)
    for members in (shuffled, shuffled[:3], np.array([18]), np.array([7])):
        for name, column in run(members).items():
            np.testing.assert_array_equal(column, whole[name][members])


def test_derivatives_of_an_escape_are_columns():
    fixed = {"system": "well", "cells": 60, "noise": 0.5, "start": -1.0, "into": "x>0"}
    batch = {"gradient": np.array([True])}
    found = columns_of(Escape, batch, fixed, 0)
    result = read_study(Escape, {**fixed, "gradient": True}).run()
    for cause, slope in zip(result.cause, result.derivative, strict=True):
        assert found[f"d_mean_time_d_{cause}"].item() == slope


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"params": ["T=0.2"], "params_T": 0.3}, "params: T is given twice, by 'T=0.2' and by"),
        ({"params": "T=0.2", "params_T": 0.3}, "params: T is given twice"),
    ],
)
def test_parameter_that_is_given_twice_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        read_study(Dynamics, {"system": "pendulum", **given})
    with pytest.raises(ValueError, match="errors: turn is given twice, by 'turn=45'"):
        read_study(Cover, {**COVER, "reliability": 0.8, "errors": "turn=45", "errors_turn": 5})


def test_results_that_need_a_goal_say_so():
    batch = {"reliability": np.array([0.6, 0.8])}
    with pytest.raises(ValueError, match="results: d_goal_time_d_reliability needs a goal"):
        columns_of(Cover, batch, {**COVER, "errors_turn": 45}, 0, ["d_goal_time_d_reliability"])
    with pytest.raises(ValueError, match="no number 'longest_periods'; did you mean longest_per"):
        columns_of(Rooms, {"room": np.arange(2)}, {"bounce": 45}, 0, ["longest_periods"])


def test_goal_that_may_be_missed_takes_forever():
    # With a sure turn of 180 degrees, robots stay on their lines.
    fixed = {"bounce": 180, "errors_turn": 0, "reliability": 1.0, "goal": "7.5,1.5"}
    study = read_study(Cover, {**COVER, **fixed})
    assert study.run().goal_time == np.inf
    with pytest.raises(ValueError, match=r"goal '1.5,1.5': the point .* lies in an obstacle"):
        dataclasses.replace(study, goal="1.5,1.5").run()


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        ({"errors_turn": 0}, r"reliability: 0.97\d* leaves a chance of an error"),
        ({"errors_turn": 30}, r"errors: 30 deg is not a whole number of the 8 directions"),
        ({"bounce": [50]}, r"bounce: 50 deg is not a whole number of the 8 directions"),
        ({"bounce": [45, 405]}, r"bounce: 405 deg comes twice"),
    ],
)
def test_wrong_parameter_of_a_batch_raises_the_error_of_a_single_run(fixed, message):
    batch = {"reliability": np.linspace(1.0, 0.8, 8)}
    with pytest.raises(ValueError, match=message):
        columns_of(Cover, batch, {**COVER, "errors_turn": 45, **fixed}, 0)


def test_parameter_of_a_system_varies_as_a_number():
    fixed = {"system": "henon", "cells": 30, "params": ["b=0.3"]}
    batch = {"params_a": np.array([0.2, 1.4, 0.9])}
    table = columns_of(Dynamics, batch, fixed, 0)
    of_images = ["groups", "periodic_cells", "longest_step", "self_images"]
    several = columns_of(Dynamics, batch, fixed, 0, [*of_images, "fraction_0", "fraction_7"])
    for i, a in enumerate(batch["params_a"].tolist()):
        result = Dynamics("henon", cells=(30,), params=(f"a={a}", "b=0.3")).run()
        assert {name: column[i] for name, column in table.items()} == {
            name: getattr(result, name) for name in table
        }
        assert (several["fraction_0"][i], several["fraction_7"][i]) == (result.fraction[0], 0)
    assert table["groups"][0] != table["groups"][1]
    # The images of the cells are enough for these numbers.
    quick = columns_of(Dynamics, batch, fixed, 0, of_images)
    for name in of_images:
        assert table[name].tolist() == several[name].tolist() == quick[name].tolist()


def test_lists_of_values_of_a_system_are_members_of_their_own():
    fixed = {"system": "henon", "cells": 12, "params": ["b=0.2:0.3:2"]}
    table = columns_of(Dynamics, {"params_a": np.array([0.2, 0.4])}, fixed, 0, ["attractors"])
    for i, a in enumerate([0.2, 0.4]):
        result = Dynamics("henon", cells=(12,), params=(f"a={a}", "b=0.2:0.3:2")).run()
        assert table["attractors"][i] == result.attractors


def test_only_wanted_numbers_are_computed(monkeypatch):
    monkeypatch.setattr("jaxcell.bounce.group_results.heading_filter_sizes", None)
    batch = {"room": np.arange(3)}
    fixed = {"bounce": 45, "columns": 9, "rows": 7, "directions": 8}
    table = columns_of(Rooms, batch, fixed, 0, ["longest_period", "count"])
    assert set(table) == {"longest_period", "count"}
    with pytest.raises(ValueError, match="results: Rooms has no number 'kemeny'"):
        columns_of(Rooms, batch, fixed, 0, ["kemeny"])


def test_each_value_of_a_column_is_within_its_limits():
    with pytest.raises(ValueError, match="room: expected at least 0, got -2"):
        columns_of(Rooms, {"room": np.array([1, -2, 3])}, {"bounce": 45}, 0)
    with pytest.raises(ValueError, match="bounce: expected one value for each member, got 2"):
        columns_of(Rooms, {"room": np.arange(2)}, {"bounce": [45, 90]}, 0)
