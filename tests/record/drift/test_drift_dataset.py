import dataclasses
import itertools
import json

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import scipy.sparse
import xarray as xr
from changed_results import changed

from jaxcell import record
from jaxcell.mapping import Chain


pytestmark = pytest.mark.usefixtures("few_drifters")


@pytest.fixture(scope="module")
def dataset(gyres, tmp_path_factory):
    file = tmp_path_factory.mktemp("drift") / "drift.nc"
    record.save_dataset(record.dataset(gyres, spec={"file": "gyres"}), file)
    return xr.load_dataset(file)


def by_cell(dataset, name):
    """The values of a variable by the number of the cell."""
    wet = dataset.cell.values >= 0
    values = np.empty(wet.sum(), dataset[name].dtype)
    values[dataset.cell.values[wet]] = dataset[name].values[wet]
    return values


def test_the_dataset_holds_the_chain_and_the_arrays_of_all_layers(gyres, dataset):
    cells = gyres.cells
    entries = dataset.transition.values, (dataset.from_cell.values, dataset.to_cell.values)
    matrix = scipy.sparse.coo_array(entries, shape=(cells, cells)).toarray()
    np.testing.assert_array_equal(matrix, gyres.sea.drift.to_scipy().toarray())
    begins = [layer.begins for layer in gyres.layers]
    for name, of_layer in {
        "group": lambda k: begins[k].groups.group,
        "transient_group": lambda k: begins[k].transient.group,
        "basin": lambda k: begins[k].basin,
        "absorption_time": lambda k: begins[k].hours,
        "leaving": lambda k: gyres.layers[k].leaving,
    }.items():
        expected = np.concatenate([np.asarray(of_layer(k)) for k in range(3)])
        np.testing.assert_array_equal(by_cell(dataset, name), expected, err_msg=name)
    for k, layer in enumerate(gyres.layers):
        wet = dataset.cell[k].values >= 0
        for group, chance in enumerate(np.asarray(layer.ends.value)):
            values = dataset.probability.sel(layer=k, group_index=group).values[wet]
            np.testing.assert_array_equal(values, chance)
    parts = [(k, n) for k in range(3) for n in range(begins[k].transient.count)]
    bounds = itertools.pairwise(dataset.domicile_offset.values)
    for (k, n), (first, last) in zip(parts, bounds, strict=True):
        homes = tuple(dataset.domicile.values[first:last])
        assert homes == begins[k].transient.domiciles[n]
    assert [*zip(dataset.transient_layer, dataset.transient_number, strict=True)] == parts


def test_the_dataset_has_places_units_and_the_spec(gyres, dataset):
    assert dataset.attrs["Conventions"] == "CF-1.8"
    assert json.loads(dataset.attrs["spec"]) == {"file": "gyres"}
    assert float(dataset.step) == 3400
    assert dataset.lon.standard_name == "longitude"
    assert dataset.depth.values.tolist() == [0, 5, 10]
    # Land is where there is no water.
    for name, blank in (("group", -2), ("voyage_action", -2)):
        assert ((dataset[name].values == blank) == ~gyres.currents.water.values).all()
    assert (np.isnan(dataset.absorption_time.values) == ~gyres.currents.water.values).all()
    cell = int(dataset.deployment_cell[1])
    lon, lat, depth = gyres.place(cell)
    row, column = np.argwhere(dataset.cell[0].values == cell)[0]
    assert (lon, lat, depth) == (dataset.lon[row, column], dataset.lat[row, column], 0)
    assert gyres.place(538 + 538)[2] == 10


def test_deployment_files(gyres, dataset, tmp_path):
    record.save_deployment(gyres, tmp_path / "d.csv")
    record.save_deployment(gyres, tmp_path / "d.geojson")
    rows = pd.read_csv(tmp_path / "d.csv")
    places = json.loads((tmp_path / "d.geojson").read_text())
    assert places["type"] == "FeatureCollection"
    points = [one["geometry"]["coordinates"] for one in places["features"]]
    listed = pd.DataFrame([one["properties"] for one in places["features"]])
    listed[["lon", "lat"]] = points
    pd.testing.assert_frame_equal(listed[rows.columns], rows, check_dtype=False)
    assert [gyres.waters[0].cell(lon, lat) for lon, lat in points] == rows.cell.tolist()
    assert (rows.group.isna() != rows.transient_group.isna()).all()
    reach = rows.cell[rows.purpose == "reach"]
    assert reach.tolist() == dataset.deployment_cell.values.tolist()
    assert rows.cell[rows.purpose == "view"].tolist() == gyres.views.cells.tolist()
    with pytest.raises(FileNotFoundError, match="no folder"):
        record.save_deployment(gyres, tmp_path / "none" / "d.csv")
    with pytest.raises(ValueError, match=r"d\.xls: expected a name that ends in \.csv or \.geo"):
        record.save_deployment(gyres, tmp_path / "d.xls")


def test_layers_and_starts_of_other_seas_are_refused(gyres):
    for change, message in (
        ({"layers": gyres.layers[:2]}, "layers: expected 3, got 2"),
        ({"start": 538}, "start: expected a cell of the surface, 0 to 537"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(gyres, **change)


def altered(layer, **fields):
    """A layer with other fields in its behaviour."""
    behaviour = dataclasses.replace(layer.behaviour, **fields)
    return dataclasses.replace(layer, behaviour=behaviour, measured=layer.compared)


def with_ends(layer, **fields):
    """An altered layer that keeps the probabilities of the ends of `layer`."""
    one = altered(layer, **fields)
    one.__dict__["ends"] = layer.ends
    return one


def test_a_layer_that_contradicts_itself_is_refused(gyres):
    layer = gyres.layers[0]
    behaviour = layer.behaviour
    chain, group = behaviour.chain, behaviour.groups.group
    few = Chain(chain.image, 0.99 * chain.probability)
    moved = dataclasses.replace(behaviour.groups, group=jnp.roll(group, 1))
    wrong = changed(altered(layer), "ends.value", lambda value: 0.9 * value)
    for one, name in (
        (with_ends(layer, chain=few), "steps_out_of_persistent_groups"),
        (with_ends(layer, groups=moved), "steps_out_of_persistent_groups"),
        (wrong, "ends_sum_to_1"),
    ):
        value, limit = one.checks()[name]
        assert value > limit
        with pytest.raises(RuntimeError, match=f"the result contradicts itself: {name} is"):
            record.dataset(dataclasses.replace(gyres, layers=(one, *gyres.layers[1:])))
    wrong = changed(wrong, "ends.value", lambda _: jnp.roll(layer.ends.value, 1, axis=0))
    assert wrong.checks()["ends_residual"][0] < 1e-8
    chance = layer.ends.value.at[0, 100].add(0.1).at[1, 100].add(-0.1)
    wrong = changed(wrong, "ends.value", lambda _: chance)
    assert wrong.checks()["ends_residual"][0] > 1e-3


def test_times_are_reported_and_refuse_nothing(gyres):
    layer = gyres.layers[0]
    solve = layer.behaviour.absorption
    slow = altered(layer, absorption=dataclasses.replace(solve, value=1.5 * solve.value))
    found = record.dataset(dataclasses.replace(gyres, layers=(slow, *gyres.layers[1:])))
    assert found.attrs["check_absorption_time_residual"] > 0.01
