"""The times of the records of a file, and which of them are asked for."""

import dataclasses
import datetime
import re
from collections.abc import Sequence
from typing import Any, TypeAlias

import cftime
import numpy as np
import xarray as xr
from jaxtyping import Int, Shaped

from ..conventions import table
from ..netcdf import OceanFile


Moment: TypeAlias = int | str | datetime.date | np.datetime64
When: TypeAlias = Moment | slice | Sequence[Moment | None] | None

SECONDS = {
    "s": 1, "sec": 1, "second": 1, "seconds": 1,
    "min": 60, "minute": 60, "minutes": 60,
    "h": 3600, "hour": 3600, "hours": 3600,
    "d": 86400, "day": 86400, "days": 86400,
}  # fmt: skip
# The years that times are counted from: those whose nanoseconds fit 64 bits, and some to spare.
_YEARS = range(1700, 2201)
# From 1970, where there is no date; their nanoseconds fit too.
_MAX_SECONDS = 9.2e9


@dataclasses.dataclass(frozen=True)
class RecordTimes:
    """When the records of a file are.

    **Attributes:**

    - `values`: of all records, in order; one after another by the seconds between them.
    - `start`: of what calendar they are dates, at the beginning of the year of the first record;
        `None` if it is the common one.
    - `dated`: whether they have a date; otherwise they are counted from 1970-01-01.
    - `note`: what is odd about them; may be empty.
    """

    values: Shaped[np.ndarray, " records"]
    start: cftime.datetime | None = None
    dated: bool = True
    note: str = ""


def record_times(file: OceanFile, dim: str | None) -> RecordTimes:
    """The time of each record.

    A year of 360 or 365 days is that long: the dates of its records go on from the beginning of
    the first one's year by as many days as lie between.

    **Arguments:**

    - `file`: an open file.
    - `dim`: the dimension of time, or `None` for a single record.

    **Raises:** `ValueError` if no variable gives them, or they are missing, in an unknown unit or
    calendar, or not in order.
    """
    name = time_variable(file, dim)
    if name is None:
        note = "time: the file has none; taken as 1970-01-01"
        return RecordTimes(np.zeros(1, "datetime64[ns]"), None, False, note)
    if 0 in file.dataset[name].shape:
        raise file.error(name, "expected a record or more, got none")
    found = _counted(file, name)
    times = found.values
    if (odd := np.isnat(times)).any():
        raise file.error(
            name, f"the time of record {int(odd.argmax())} is missing, or not from 1678 to 2261"
        )
    backwards = np.diff(times) <= np.timedelta64(0, "ns")
    if backwards.any():
        k = int(backwards.argmax())
        raise file.error(
            name, f"expected times in order, got {times[k + 1]} after {times[k]} (record {k + 1})"
        )
    return found


def read_times(file: OceanFile, name: str) -> Shaped[np.ndarray, " records"]:
    """The times of a variable: dates as datetime64, or in another calendar as cftime has them;
    without a date in seconds.
    """
    variable = file.dataset[name]
    if variable.dtype.kind in "MO":
        return variable.values.reshape(-1)
    units = str(variable.attrs.get("units", ""))
    if " since " in units:
        return _decode(file, name)
    if units.lower() not in SECONDS:
        raise file.error(name, f"units: expected a unit of time since a date, got {units!r}")
    seconds = file.read(variable).reshape(-1) * SECONDS[units.lower()]
    if not np.isfinite(seconds).all():
        raise file.error(name, "a time is missing")
    return seconds


def _counted(file: OceanFile, name: str) -> RecordTimes:
    """The times of a variable, each by the time since the first."""
    times = read_times(file, name)
    if times.dtype.kind == "M":
        return RecordTimes(_in_nanoseconds(times))
    if times.dtype.kind == "f":
        units = file.dataset[name].attrs["units"]
        seconds = np.where(np.abs(times) < _MAX_SECONDS, times, np.nan)
        values = np.datetime64(0, "ns") + np.round(seconds * 1e9).astype("timedelta64[ns]")
        note = f"{name}: {units} without a date; counted from 1970-01-01"
        return RecordTimes(values, None, False, note)
    first = times[0]
    if not isinstance(first, cftime.datetime) or first.year not in _YEARS:
        raise file.error(
            name, f"expected dates in the years {_YEARS[0]} to {_YEARS[-1]}, got {first}"
        )
    start = cftime.datetime(first.year, 1, 1, calendar=first.calendar)
    values = _in_nanoseconds(np.array([_since(start, one) for one in times]))
    note = f"{name}: calendar {start.calendar}; its days are counted on from {first.year}-01-01"
    return RecordTimes(values, start, True, note)


def _since(start: cftime.datetime, date: cftime.datetime) -> np.datetime64:
    """A date of another calendar, by the days since the beginning of a year."""
    return np.datetime64(f"{start.year}-01-01", "us") + np.timedelta64(date - start)


def _in_nanoseconds(dates: Any) -> Any:
    """Dates in 64 bits of nanoseconds, NaT where they are not from 1678 to 2261."""
    fits = (dates >= np.datetime64("1678-01-01")) & (dates < np.datetime64("2262-01-01"))
    found = np.array(dates)
    found[~fits] = np.datetime64("NaT", "s")
    return found.astype("datetime64[ns]")[()]


def choose_records(file: OceanFile, times: RecordTimes, when: When) -> Int[np.ndarray, " chosen"]:
    """The numbers of the records that are asked for.

    A moment is the nearest record, the later of two that are equally near: so a date alone
    stands for the mean over its day. It must be within half the usual time between records.

    **Arguments:**

    - `file`: for messages.
    - `times`: of all records; where they have no date, only indices are accepted.
    - `when`: as `time` of [`jaxcell.drift.open_currents`][]; a date is one of their calendar.

    **Raises:** `ValueError` for a time that the file does not have.
    """
    records = np.arange(len(times.values))
    if when is None:
        return records
    if isinstance(when, slice):
        if not (when.step is None or (_is_index(when.step) and when.step > 0)):
            raise file.error("time", f"expected a step of 1 or more, got {when}")
        if all(end is None or _is_index(end) for end in (when.start, when.stop)):
            chosen = records[when]
            if chosen.size == 0:
                raise file.error("time", f"{when} holds none of the {len(records)} records")
            return chosen
        if when.step is not None:
            raise file.error("time", f"expected a slice of times without a step, got {when}")
        when = (when.start, when.stop)
    if isinstance(when, (list, tuple)):
        if len(when) != 2:
            raise file.error("time", f"expected the first and the last time, got {when!r}")
        first = 0 if when[0] is None else _record(file, times, when[0])
        last = len(records) - 1 if when[1] is None else _record(file, times, when[1])
        if first > last:
            raise file.error("time", f"expected the earlier time first, got {when!r}")
        return records[first : last + 1]
    return records[[_record(file, times, when)]]


def _record(file: OceanFile, records: RecordTimes, moment: Any) -> int:
    times = records.values
    if _is_index(moment):
        if not -len(times) <= moment < len(times):
            raise file.error("time", f"record {moment}: the file has 0 to {len(times) - 1}")
        return int(moment) % len(times)
    if not records.dated:
        raise file.error(
            "time", f"expected the index of a record, as they have no date, got {moment!r}"
        )
    wanted = _moment(file, moment, records.start)
    nearest = len(times) - 1 - int(np.abs(times - wanted)[::-1].argmin())
    slack = np.median(np.diff(times)) / 2 if len(times) > 1 else np.timedelta64(0, "ns")
    if abs(times[nearest] - wanted) > slack:
        first, last, closest = times[[0, -1, nearest]].astype("datetime64[s]")
        raise file.error(
            "time", f"{moment}: the nearest of the records from {first} to {last} is {closest}"
        )
    return nearest


def _moment(file: OceanFile, moment: Any, start: cftime.datetime | None) -> np.datetime64:
    try:
        if start is not None:  # a day such as 2001-02-30 is one of its calendar only
            parts = [int(part) for part in re.split(r"[-T :]", str(moment).removesuffix("Z"))]
            wanted = _since(start, cftime.datetime(*parts, calendar=start.calendar))
        else:
            if isinstance(moment, str):
                moment = datetime.datetime.fromisoformat(moment)
            if isinstance(moment, datetime.datetime) and moment.tzinfo is not None:
                moment = moment.astimezone(datetime.UTC).replace(tzinfo=None)
            wanted = np.datetime64(moment)
    except (TypeError, ValueError) as error:
        raise file.error(
            "time",
            f"expected an index or a date such as 2016-02-02T12:00, got {moment!r}",
        ) from error
    wanted = _in_nanoseconds(wanted)
    if np.isnat(wanted):
        raise file.error("time", f"expected a date from 1678 to 2261, got {moment!r}")
    return wanted


def _is_index(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def time_variable(file: OceanFile, dim: str | None) -> str | None:
    """The coordinate variable of the dimension, or another that gives the time on it."""
    variables = file.dataset.variables
    names = next(table("time")).names
    if dim is None:
        return next((n for n in names if n in variables and variables[n].size == 1), None)
    if dim in variables:
        return dim
    for name, variable in variables.items():
        is_time = " since " in str(variable.attrs.get("units", "")) or variable.dtype.kind == "M"
        if variable.dims == (dim,) and (is_time or str(name).lower() in names):
            return str(name)
    raise file.error(dim, "no variable gives the times of this dimension")


def _decode(file: OceanFile, name: str) -> Shaped[np.ndarray, " records"]:
    try:
        variable = file.dataset[[name]].reset_coords().variables[name]
        decoded = xr.decode_cf(xr.Dataset({"decoded": variable}))["decoded"].values.reshape(-1)
    except Exception as error:  # what a damaged file makes the libraries raise is not written
        units = file.dataset[name].attrs["units"]
        raise file.error(name, f"times in {units!r} cannot be read: {error}") from error
    return decoded
