"""Tracks in tables of text, and tracks without an id, each with what a correct reader says."""

import contextlib
import warnings

import numpy as np
import pytest
import xarray as xr

from jaxcell import drift
from jaxcell.base.doubts import Doubt


ROWS = [
    ("a", "2020-01-01T00:00:00Z", 60.0, 4.0),
    ("a", "2020-01-01T06:00:00Z", 60.1, 4.1),
    ("b", "2020-01-01T00:00:00Z", 61.0, 5.0),
    ("b", "2020-01-01T06:00:00Z", 61.1, 5.1),
]


def table(header, rows=ROWS, mark=",", order=(0, 1, 2, 3)):
    lines = [mark.join(str(row[k]) for k in order) for row in rows]
    return "\n".join([*([header] if isinstance(header, str) else header), *lines, ""])


def seconds(rows):
    return [(name, int(np.datetime64(time[:-1], "s").astype(int)), *at) for name, time, *at in rows]


SEEN = {
    "plain": table("id,time,lat,lon"),
    "ERDDAP": table(["ID,time,latitude,longitude", ",UTC,degrees_north,degrees_east"]),
    "ERDDAP csvp": table("ID,time (UTC),latitude (degrees_north),longitude (degrees_east)"),
    "upper case": table("WMO,TIME,LATITUDE,LONGITUDE"),
    "semicolons": table("drifter;date;lat;lon", mark=";"),
    "tabs": table("buoy\tdatetime\tlat\tlon", mark="\t"),
    "comments": "# a buoy\n\n" + table("platform,timestamp,lat,lon"),
    "other order": table("lon,lat,time,name", order=(3, 2, 1, 0)),
    "without Z": table("id,time,lat,lon").replace("Z", ""),
    "slashes": table("id,time,lat,lon").replace("2020-01-01T", "2020/01/01 "),
    "UTC in words": table("id,time,lat,lon").replace("Z", " UTC"),
    "a byte-order mark": "\ufeff" + table("id,time,lat,lon"),
    "seconds": table("id,time (seconds since 1970-01-01),lat,lon", seconds(ROWS)),
    "empty cells": table("id,time,lat,lon", [*ROWS, ("b", "2020-01-01T12:00:00Z", "", "")]),
    "not a number": table("id,time,lat,lon", [*ROWS, ("b", "2020-01-01T12:00:00Z", "NaN", "NaN")]),
    "another column": table(
        "id,time,lat,lon,note", [(*row, "fine") for row in ROWS], order=(0, 1, 2, 3, 4)
    ),
    "any order of rows": table("id,time,lat,lon", ROWS[::-1]),
    "windows": table("id,time,lat,lon").replace("\n", "\r\n"),
}


@pytest.mark.parametrize("quirk", SEEN)
def test_tables_are_read(quirk, tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_bytes(SEEN[quirk].encode())
    seen = drift.open_trajectories(path)
    assert seen.drifter.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(seen.lon, [4.0, 4.1, 5.0, 5.1])
    np.testing.assert_allclose(seen.lat, [60.0, 60.1, 61.0, 61.1])
    np.testing.assert_array_equal(seen.time - seen.time[0], [0, 21600, 0, 21600])
    assert seen.since == "1970-01-01"
    assert seen.time[0] == np.datetime64("2020-01-01", "s").astype(int)


REFUSED = {
    "": "expected a line of names of columns",
    "lat,lon\n60,4\n": "time: expected trajectories with a time, got lat, lon",
    "id,time,lat,lon\na,soon,60,4\n": "time: expected dates such as",
    "id,time,lat,lon\na,2020-01-01,60\n": "row 0: expected 4 values",
    "time,lat,lon\n2020-01-02,60,4\n2020-01-01,60,4\n": "expected a count .* named id",
    "id,time,lat,lon\na,100,60,4\n": "time: units: expected a unit of time",
    "id,time,lat,lon\na,2020-01-01,sixty,4\n": "lat: expected numbers",
}


@pytest.mark.parametrize("text", REFUSED)
def test_damaged_tables_are_refused(text, tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"tracks.csv: .*{REFUSED[text]}"):
        drift.open_trajectories(path)


@pytest.mark.parametrize("again", [0, 1, 3])
def test_a_track_without_an_id_and_its_double_fixes_are_said(again, tmp_path):
    hours = np.array([0, 1, 2, 3, *[3] * again])
    dims = ("obs",)
    file = xr.Dataset(
        {"lon": (dims, 4 + hours / 100), "lat": (dims, 60 + 0.0 * hours)},
        {"time": (dims, hours, {"units": "hours since 2020-01-01"})},
    )
    file.to_netcdf(tmp_path / "track.nc")
    doubled = pytest.warns(Doubt, match=f"{again} of {4 + again} observations .* the same time")
    with (
        pytest.warns(Doubt, match="no variable names the drifters; taken as one drifter"),
        doubled if again else contextlib.nullcontext(),
    ):
        seen = drift.open_trajectories(tmp_path / "track.nc")
    assert seen.drifters == 1
    np.testing.assert_allclose(seen.lon, [4.0, 4.01, 4.02, 4.03])


def test_files_of_any_layout_are_read_together(tmp_path):
    (tmp_path / "table.csv").write_text(SEEN["ERDDAP"])
    matrix = xr.Dataset(
        {name: (("trajectory", "time"), [[at, at]]) for name, at in (("lon", 7.0), ("lat", 62.0))},
        {"time": ("time", [0, 6], {"units": "hours since 2020-01-01"})},
    )
    matrix.to_netcdf(tmp_path / "matrix.nc")
    with warnings.catch_warnings(action="error"):
        seen = drift.open_trajectories([tmp_path / "table.csv", tmp_path / "matrix.nc"])
    assert seen.drifter.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(seen.time[4:], seen.time[:2])
