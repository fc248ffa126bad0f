import dataclasses
import datetime
import json
import math
import subprocess

import numpy as np
import pytest
import xarray as xr

import jaxcell
from jaxcell.automata import Filter
from jaxcell.bounce import LocalizationFilter, Localized
from jaxcell.record import dataset as dataset_of, save_dataset
from jaxcell.space import CELL_BY_CELL, CellSpace


def reload(dataset, path):
    save_dataset(dataset, path)
    with xr.open_dataset(path) as opened:
        return opened.load()


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


def test_tables_of_a_batch(angles):
    groups, dataset = angles, dataset_of(angles)
    counts = dataset["count"].values
    assert len(set(counts)) > 1, "this batch needs padding"
    for i, count in enumerate(counts):
        group, step, period = (a[i].ravel() for a in (groups.group, groups.step, groups.period))
        assert set(group) == set(range(count))
        for one in range(count):
            inside = group == one
            assert dataset.group_period[i, one] == np.sum(inside & (step == 0))
            assert set(period[inside]) == {dataset.group_period[i, one].item()}
            assert dataset.group_basin[i, one] == np.sum(inside)
            assert dataset.group_transient[i, one] == max(step[inside])
        for table in ("group_period", "group_basin", "group_transient"):
            assert (dataset[table][i, count:] == -1).all()


def test_groups_round_trip(angles, tmp_path):
    dataset = dataset_of(angles, spec={"map": "lab", "n": [1, 2]})
    opened = reload(dataset, tmp_path / "groups.nc")
    xr.testing.assert_identical(opened, dataset)
    assert opened.reset_coords().dtypes == dataset.reset_coords().dtypes
    assert {dataset[name].dtype for name in ("group", "step", "period")} == {np.dtype(np.int32)}
    assert dataset.periodic.dtype == bool
    assert dataset.group.dims == ("bounce", "direction", "position")
    assert all("units" in dataset[n].attrs for n in ("x", "y", "theta", "step", "bounce"))


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


def test_filter_round_trip(lab, tmp_path):
    for filter in (lab.filter, lab.filter.with_trap()):
        made = dataset_of(LocalizationFilter(filter), spec=filter.metadata)
        dataset = reload(made, tmp_path / "filter.nc")
        again = Filter(
            transition=dataset.transition.values,
            uncertainty=dataset.uncertainty.values,
            offsets=dataset.offset.values,
            members=dataset.member.values,
            open_world=filter.open_world,
            metadata=json.loads(dataset.attrs["spec"]),
        )
        assert again.metadata == filter.metadata
        np.testing.assert_array_equal(dataset.color, again.color)
        cycles = again.cycles
        assert len(cycles) == dataset.sizes["cycle"] == 3
        bounds = dataset.cycle_offset.values
        for i, cycle in enumerate(cycles):
            states = dataset.cycle_state.values[bounds[i] : bounds[i + 1]]
            np.testing.assert_array_equal(states, cycle.states)
            assert dataset.cycle_uncertainty[i] == cycle.uncertainty
            assert dataset.cycle_color[i] == cycle.color


def test_parts_of_different_maps_are_refused(lab, hall):
    other = CellSpace.of_grid(np.ones((2, 2), bool), 8)
    for bad in ({"a": {1, 2}}, {"a": math.inf}):
        with pytest.raises(ValueError, match="spec: expected a JSON object"):
            dataset_of(lab.groups, spec=bad)
    with pytest.raises(ValueError, match="starts with 152 possible cells, but there are 32"):
        Localized(lab.filter, other, CELL_BY_CELL, lab.bounce, lab.localize(3))
    with pytest.raises(ValueError, match=r"path\[.*\] is cell"):
        dataclasses.replace(lab.localized(100), run=hall.localize(hall.cells.size - 1))
