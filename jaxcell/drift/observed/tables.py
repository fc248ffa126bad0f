"""Trajectories in tables of text, such as those of ERDDAP and of makers of buoys."""

import csv
import os
import re
from pathlib import Path

import numpy as np
import xarray as xr


_DATES = ("time", "date", "datetime", "date_time", "timestamp", "datetime_utc", "time_utc")


def read_csv(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read the columns of a table as variables on the dimension `row`.

    The first line has the names. A unit follows a name in brackets, or the second line has the
    units, as in files of ERDDAP. Lines that begin with `#` are comments.

    **Raises:** `ValueError` with the file and the line for a table that is damaged.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        lines = [line for line in text.splitlines() if line.strip() and line[0] != "#"] or [""]
        mark = max(",;\t", key=lines[0].count)
        header, *rows = csv.reader(lines, delimiter=mark, strict=True)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{name}: cannot be read as a table of text: {error}") from error
    if not header:
        raise ValueError(f"{name}: expected a line of names of columns, got an empty table")
    names, _, units = np.array(
        [re.sub(r"[\s)]+$", "", word).partition("(") for word in header]
    ).T.tolist()
    if rows and not any(re.search(r"\d", word) for word in rows[0]):
        units, rows = rows[0], rows[1:]
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"{name}: row {number}: expected {len(header)} values, got {row}")
    columns = {}
    for column, unit, words in zip(names, units, zip(*rows, strict=True), strict=True):
        key = column.strip().lower()
        values, about = np.array([word.strip() for word in words]), {"units": unit}
        try:
            values = np.where(values == "", "nan", values).astype(float)
        except ValueError:
            if key in _DATES:
                values, about = _moments(name, values), {}
        key = "time" if key in _DATES and "time" not in columns else key
        columns[key] = ("row", values, about)
    dataset = xr.Dataset(columns)
    dataset.encoding["source"] = name
    return dataset


def _moments(name: str, words: np.ndarray) -> np.ndarray:
    dates = [re.sub(r"(Z|\s*UTC|\+00:?00)$", "", word).replace("/", "-") for word in words]
    try:
        return np.array([date or "NaT" for date in dates], "datetime64[us]")
    except ValueError as error:
        raise ValueError(
            f"{name}: time: expected dates such as 2020-03-01T06:00Z, or a unit such as (seconds "
            f"since 1970-01-01) after its name: {error}"
        ) from error
