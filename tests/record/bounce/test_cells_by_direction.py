import math

import numpy as np
import pytest
import xarray as xr

from jaxcell import bundled, record
from jaxcell.bounce import BounceGroups, bounce_map
from jaxcell.record.bounce import cells_by_direction
from jaxcell.space import ENDPOINT, CellSpace, Motion, Workspace


def groups_of(name, cell, directions, turns, **motion):
    cells = CellSpace.of(Workspace.load(bundled(f"maps/{name}.json")), cell, directions)
    return BounceGroups.of(cells, 2 * math.pi * np.array(turns) / directions, **motion)


# A grid, walls along squares that are not of it, and slanted walls in more ways than have tables.
@pytest.mark.parametrize(
    ("name", "cell", "directions", "motion"),
    [
        ("lab_a", 1.0, 8, {"motion": Motion(2.0)}),
        ("lab_a", 0.7, 6, {"motion": ENDPOINT}),
        ("cafe", 0.9, 40, {}),
    ],
)
def test_a_store_has_what_is_in_memory(monkeypatch, tmp_path, name, cell, directions, motion):
    # A run longer than what is followed at once; files of the second end within a direction.
    monkeypatch.setattr("jaxcell.bounce.straight_runs.AT_ONCE", 7)
    monkeypatch.setattr(cells_by_direction, "CHUNK", 37)
    groups = groups_of(name, cell, directions, [3, 0, 1], **motion)
    record.save_cells(groups, tmp_path / "groups.zarr", spec={"bounce_deg": 3})
    with xr.open_zarr(tmp_path / "groups.zarr") as stored:
        stored.load()
    image = np.asarray(bounce_map(groups.cells, groups.bounce, motion=groups.motion).image)
    np.testing.assert_array_equal(stored.image.values.reshape(image.shape), image)
    expected = record.dataset(groups, spec={"bounce_deg": 3})
    xr.testing.assert_equal(stored.drop_vars("image"), expected)
    for one in expected.variables:
        assert stored[one].attrs == expected[one].attrs
        assert stored[one].dtype == expected[one].dtype or one.startswith("group_")
    said = {key for key in expected.attrs if not key.startswith(("check_", "created"))}
    assert {key: stored.attrs[key] for key in said} == {key: expected.attrs[key] for key in said}
    assert stored.attrs["check_image_violations"] == 0


def test_a_store_is_written_whole_or_not_at_all(monkeypatch, tmp_path):
    found, path = groups_of("lab_a", 1.0, 4, [1]), tmp_path / "groups.zarr"
    record.save_cells(found, path, spec={"try": 1})
    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as patch:
        patch.setattr(BounceGroups, "by_angle", lambda _: iter([1 / 0]))
        with pytest.raises(ZeroDivisionError):
            record.save_cells(found, path, spec={"try": 2})
    assert sorted(tmp_path.rglob("*")) == before
    record.save_cells(found, path, spec={"try": 3})
    assert [one.name for one in tmp_path.iterdir()] == ["groups.zarr"]
    assert xr.open_zarr(path).attrs["spec"] == '{"try": 3}'


def test_cells_that_contradict_the_numbers_are_not_written(tmp_path):
    groups = groups_of("lab_a", 1.0, 4, [1])
    groups.largest_basin[0] += 1
    with pytest.raises(RuntimeError, match="numbers_not_those_of_cells is 1, expected at most 0"):
        record.save_cells(groups, tmp_path / "groups.zarr")
    assert not [*tmp_path.iterdir()]
