"""Trajectories in several files, and observations that no drifter can reach."""

import json
import math

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, strategies as st

from jaxcell import drift
from jaxcell.base.doubts import Doubt
from jaxcell.cli import main


HOUR = 3600.0


def run(lon, since, name="trajectory"):
    """Particles at 60 N in one model run, a row each, every hour from a date."""
    lon = np.array(lon, float)
    time = ("time", np.arange(lon.shape[1]), {"units": f"hours since {since}"})
    dims = (name, "time")
    data = {"lon": (dims, lon), "lat": (dims, np.full(lon.shape, 60.0))}
    return xr.Dataset(data, {"time": time, name: np.arange(lon.shape[0])})


def one_drifter(label, lon, since="1970-01-01"):
    """Describe a single drifter as a dataset: a ragged array with its label."""
    about = {"units": f"seconds since {since} 00:00:00"}
    return xr.Dataset(
        {
            "longitude": ("obs", np.array(lon, float)),
            "latitude": ("obs", np.full(len(lon), 60.0)),
            "rowsize": ("traj", [len(lon)], {"sample_dimension": "obs"}),
            "ID": ("traj", [label]),
        },
        {"time": ("obs", HOUR * np.arange(len(lon)), about)},
    )


def write(folder, **files):
    for name, dataset in files.items():
        dataset.to_netcdf(folder / f"{name}.nc")
    return [folder / f"{name}.nc" for name in files]


def test_particles_of_two_runs_are_kept_apart(tmp_path):
    first, second = [[4.0, 4.1, 4.2], [5.0, 5.1, np.nan]], [[4.0, 3.9, 3.8]]
    paths = write(tmp_path, a=run(first, "2020-01-01"), b=run(second, "2020-01-02"))
    for source in (paths, str(tmp_path / "?.nc")):
        seen = drift.open_trajectories(source)
        assert seen.drifters == 3
        assert seen.drifter.tolist() == [0, 0, 0, 1, 1, 2, 2, 2]
        np.testing.assert_allclose(seen.lon, [4.0, 4.1, 4.2, 5.0, 5.1, 4.0, 3.9, 3.8])
        # All times are counted from the date of the first file.
        assert seen.since == "2020-01-01"
        assert (seen.time / HOUR).tolist() == [0, 1, 2, 0, 1, 24, 25, 26]
    assert seen.source == "a.nc, b.nc"


def test_a_file_for_each_drifter_is_one_set_of_drifters(tmp_path):
    """More files than a process may have open at once on some systems are read one by one."""
    tracks = {f"drifter_{n}": one_drifter(7, [10 + 0.01 * n, 10.1 + 0.01 * n]) for n in range(20)}
    write(tmp_path, **tracks)
    seen = drift.open_trajectories(tmp_path / "drifter_*.nc")
    assert seen.drifters == 20
    assert np.bincount(seen.drifter).tolist() == [2] * 20


def test_files_of_different_layouts_are_joined(tmp_path):
    paths = write(tmp_path, a=run([[4.0, 4.1]], "2020-01-01"), b=one_drifter(3, [1.0, 1.1, 1.2]))
    seen = drift.open_trajectories(paths)
    assert np.bincount(seen.drifter).tolist() == [2, 3]


def test_a_drogue_that_some_files_do_not_tell_is_not_known(tmp_path):
    known = one_drifter(1, [1.0, 1.1]).assign(drogue_status=("obs", [1, 0]))
    paths = write(tmp_path, a=known, b=one_drifter(2, [2.0, 2.1]))
    with pytest.warns(Doubt, match="a.nc, b.nc: the drogue is known in 1 of 2 files"):
        seen = drift.open_trajectories(paths)
    assert seen.drogued is None
    again = write(tmp_path, b=one_drifter(2, [2.0, 2.1]).assign(drogue_status=("obs", [0, 0])))
    assert drift.open_trajectories([paths[0], *again]).drogued.tolist() == [True, *[False] * 3]


def test_a_file_that_is_no_trajectory_is_named(tmp_path):
    sea = xr.Dataset({"uo": (("y", "x"), np.ones((2, 2)))})
    paths = write(tmp_path, a=run([[4.0, 4.1]], "2020-01-01"), b=sea)
    with pytest.raises(ValueError, match=r"b\.nc: lon: expected trajectories with a longitude"):
        drift.open_trajectories(paths)


def test_the_command_counts_a_fix_without_satellites(tmp_path, capsys):
    """Two drifters at 60 N move by 0.1 degrees per hour; one of them has a fix at 0 N 0 E."""
    lon = 5 + 0.1 * np.array([np.arange(30), np.arange(30)])
    dataset = run(lon, "2020-01-01")
    dataset["lon"][1, 10] = dataset["lat"][1, 10] = 0.0
    [path] = write(tmp_path, track=dataset)
    assert main(["drifters", str(path), "--lag", "0.125", "--samples", "2", "--json"]) == 0
    out, err = capsys.readouterr()
    assert "track.nc: 1 of 60 observations are left out, which drifters could reach only at" in err
    assert "at 0 N, 0 E" in err
    # The move into the fix, the move from it, and no other is missing of twice 27.
    assert json.loads(out)["moves"] == 52
    assert json.loads(out)["observations"] == 59


def test_a_drifter_without_any_fix_is_left_out_and_one_that_crosses_0_0_is_kept(tmp_path):
    """A track of zeros, one whose fixes are mostly zeros, and one that passes through 0 N 0 E."""
    lon = np.array([[0.0] * 9, [5.0, 5.1, *[0.0] * 7], np.arange(-4, 5) / 100])
    dataset = run(lon, "2020-01-01")
    dataset["lat"][:] = np.where(lon == 0, 0.0, np.where(lon > 1, 60.0, 0.0))
    [path] = write(tmp_path, track=dataset)
    with pytest.warns(Doubt, match="16 of 27 observations are left out"):
        seen = drift.open_trajectories(path)
    assert sorted(seen.lon.round(2).tolist()) == sorted([5.0, 5.1, *lon[2].tolist()])
    assert seen.drifters == 2


def metres(a, b):
    """The distance by the law of haversines."""
    (x, y), (p, q) = (map(math.radians, place) for place in (a, b))
    half = math.sin((q - y) / 2) ** 2 + math.cos(y) * math.cos(q) * math.sin((p - x) / 2) ** 2
    return 2 * 6371000 * math.asin(math.sqrt(half))


@given(st.integers(0, 2**32 - 1))
def test_single_wrong_fixes_are_left_out_and_no_others(seed):
    """Tracks at 1 m/s at most, of which a few fixes, not the half, are far away."""
    random = np.random.default_rng(seed)
    step = random.uniform(-0.03, 0.03, (2, 30))
    lon, lat = 170 + step[0].cumsum(), -40 + step[1].cumsum()
    wrong = random.choice(30, 5, replace=False)
    lon[wrong], lat[wrong] = random.uniform(-60, 60, 5), random.uniform(-10, 60, 5)
    time, drifter = HOUR * np.arange(30), np.repeat([0, 1], 15)
    # No piece of wrong fixes may be as long as the longest of right ones.
    seen = drift.Trajectories.of(lon, lat, time, drifter)
    right = np.setdiff1d(np.arange(30), wrong)
    if (np.bincount(drifter[wrong], minlength=2) <= 2).all():
        np.testing.assert_allclose(seen.lat, lat[right])
    for i, j in zip(range(seen.lon.size), range(1, seen.lon.size), strict=False):
        if seen.drifter[i] == seen.drifter[j]:
            far = metres((seen.lon[i], seen.lat[i]), (seen.lon[j], seen.lat[j]))
            assert far <= 10 * (seen.time[j] - seen.time[i]) + 1000.1


def test_a_track_that_begins_with_wrong_fixes_is_kept():
    lon, lat = np.array([0.0, 0.0, 5.0, 5.01, 5.02, 5.03]), np.array([0.0, 0.0, 60, 60, 60, 60])
    with pytest.warns(Doubt, match="2 of 6 observations"):
        seen = drift.Trajectories.of(lon, lat, HOUR * np.arange(6), np.zeros(6, int))
    np.testing.assert_allclose(seen.lon, [5.0, 5.01, 5.02, 5.03])


def test_an_error_of_a_position_is_no_impossible_move():
    """Fixes a second apart that differ by 100 m, although no drifter moves at 100 m/s."""
    lat = np.tile([0.0, 0.0009], 10)
    seen = drift.Trajectories.of(0 * lat, lat, np.arange(20.0), np.zeros(20, int))
    assert seen.lat.size == 20


@pytest.mark.parametrize("at", [1, 40, 99])
def test_two_fixes_in_a_few_seconds_do_not_cut_a_track(at):
    """The second of two fixes is 1.5 km off, 15 s later; the others are half an hour apart."""
    time, lat = 1800.0 * np.arange(100), 77 + 0.001 * np.arange(100)
    time, lat = np.insert(time, at, time[at - 1] + 15), np.insert(lat, at, lat[at - 1] + 0.0135)
    with pytest.warns(Doubt, match="1 of 101 observations are left out"):
        seen = drift.Trajectories.of(np.full(101, 26.0), lat, time, np.zeros(101, int))
    assert seen.time.size == 100
    assert np.diff(seen.time).min() >= 1785
