"""Datasets, and checks of results that see each kind of damage."""

import dataclasses
import datetime
import json
import math
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from changed_results import changed

import jaxcell
from jaxcell.bounce import Localized, TeamOutcome, TeamTrajectory, plan
from jaxcell.record import dataset as dataset_of, save_dataset
from jaxcell.space import CELL_BY_CELL, CellSpace


def test_groups_by_direction_and_position(lab):
    dataset = dataset_of(lab.groups).squeeze("bounce")
    host = lab.host()
    for name in ("group", "step", "period"):
        np.testing.assert_array_equal(dataset[name].values.ravel(), getattr(host, name))
    for z in range(lab.cells.size):
        direction, position = divmod(z, lab.cells.positions)
        cell = dataset.isel(direction=direction, position=position)
        assert (cell.x, cell.y, cell.theta) == lab.cells.centre(z)
        assert cell.theta_deg == pytest.approx(45 * direction)
        # Going on until the cell returns says whether it is periodic.
        orbit, at = set(), int(host.image[z])
        while at not in orbit and at != z:
            orbit.add(at)
            at = int(host.image[at])
        assert cell.periodic == (at == z)
    assert dataset.bounce.item() == lab.bounce
    assert dataset.bounce_deg.item() == pytest.approx(45)


def test_provenance(lab):
    spec = {"map": "lab", "bounce_deg": 45.0, "nothing": None}
    before = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    attributes = dataset_of(lab.groups, spec=spec).attrs
    assert json.loads(attributes["spec"]) == spec
    assert attributes["jaxcell_version"] == jaxcell.__version__
    created = datetime.datetime.fromisoformat(attributes["created"])
    assert before <= created <= datetime.datetime.now(datetime.UTC)
    folder = jaxcell.__path__[0]
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=folder, capture_output=True, text=True)
    if head.returncode == 0:
        assert attributes["git_revision"].removesuffix("-dirty") == head.stdout.strip()


def test_parts_of_different_maps_are_refused(lab, hall):
    other = CellSpace.of_grid(np.ones((2, 2), bool), 8)
    for bad in ({"a": {1, 2}}, {"a": math.inf}):
        with pytest.raises(ValueError, match="spec: expected a JSON object"):
            dataset_of(lab.groups, spec=bad)
    with pytest.raises(ValueError, match="starts with 152 possible cells, but there are 32"):
        Localized(lab.filter, other, CELL_BY_CELL, lab.bounce, lab.localize(3))
    with pytest.raises(ValueError, match=r"path\[.*\] is cell"):
        dataclasses.replace(lab.localized(100), run=hall.localize(hall.cells.size - 1))


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
    dataset_of(result)
    wrong = changed(result, name, change)
    with pytest.raises(RuntimeError, match="the result contradicts itself") as refusal:
        dataset_of(wrong)
    # The refusal names the first of several checks that fail.
    assert f"{check} is " in str(refusal.value) or check in failing(wrong.checks())


def test_a_robot_may_be_lost_if_the_filter_is_of_another_map(localized):
    lost = changed(localized, "run.path", put(-1, 0))
    assert not failing(lost.checks())
    assert lost.checks()["states_without_the_robot"][0] == 1


def test_a_library_that_fails_to_write_is_an_error_of_the_disk(tmp_path, monkeypatch):
    def fail(self, path, **_):
        path.write_bytes(b"half")
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(OSError, match=r"one.nc: it cannot be written, the disk may be full"):
        save_dataset(xr.Dataset(), tmp_path / "one.nc")
    assert not any(tmp_path.iterdir())
