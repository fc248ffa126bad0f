"""The times of the records of a file, and which of them are asked for."""

import datetime
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from jaxtyping import Int, Shaped

from .netcdf import OceanFile


Moment: TypeAlias = int | str | datetime.date | np.datetime64
When: TypeAlias = Moment | slice | Sequence[Moment | None] | None

_SECONDS = {
    "s": 1, "sec": 1, "second": 1, "seconds": 1,
    "min": 60, "minute": 60, "minutes": 60,
    "h": 3600, "hour": 3600, "hours": 3600,
    "d": 86400, "day": 86400, "days": 86400,
}  # fmt: skip
_NAMES = ("time", "ocean_time", "scrum_time", "time_counter")


def record_times(
    file: OceanFile, dim: str | None
) -> tuple[Shaped[np.ndarray, " records"], str | None]:
    """The time of each record as datetime64.

    Times without a date are counted from 1970-01-01.

    **Arguments:**

    - `file`: an open file.
    - `dim`: the dimension of time, or `None` for a single record.

    **Returns:** the times, and a notice if they have no date.

    **Raises:** `ValueError` if no variable gives them, or they are missing, in an unknown unit or
    calendar, or not in order.
    """
    name = _time_variable(file, dim)
    if name is None:
        return np.zeros(1, "datetime64[ns]"), "time: the file has none; taken as 1970-01-01"
    variable = file.dataset[name]
    units = str(variable.attrs.get("units", ""))
    notice = None
    if " since " in units:
        times = _decode(file, name)
    elif units.lower() in _SECONDS:
        seconds = file.read(variable).reshape(-1) * _SECONDS[units.lower()]
        if not np.isfinite(seconds).all():
            raise file.error(name, "a time is missing")
        times = np.datetime64(0, "ns") + np.round(seconds * 1e9).astype("timedelta64[ns]")
        notice = f"{name}: {units} without a date; counted from 1970-01-01"
    else:
        raise file.error(name, f"units: expected a unit of time since a date, got {units!r}")
    if times.size == 0:
        raise file.error(name, "expected a record or more, got none")
    if np.isnat(times).any():
        raise file.error(name, f"the time of record {int(np.isnat(times).argmax())} is missing")
    backwards = np.diff(times) <= np.timedelta64(0, "ns")
    if backwards.any():
        k = int(backwards.argmax())
        raise file.error(
            name, f"expected times in order, got {times[k + 1]} after {times[k]} (record {k + 1})"
        )
    return times, notice


def choose_records(
    file: OceanFile, times: Shaped[np.ndarray, " records"], when: When, dated: bool
) -> Int[np.ndarray, " chosen"]:
    """The numbers of the records that are asked for.

    A moment is the nearest record, the later of two that are equally near: so a date alone
    stands for the mean over its day. It must be within half the usual time between records.

    **Arguments:**

    - `file`: for messages.
    - `times`: of all records, in order.
    - `when`: as `time` of [`jaxcell.drift.open_currents`][].
    - `dated`: whether the times have a date; otherwise only indices are accepted.

    **Raises:** `ValueError` for a time that the file does not have.
    """
    records = np.arange(len(times))
    if when is None:
        return records
    if isinstance(when, slice):
        if all(end is None or _is_index(end) for end in (when.start, when.stop)):
            chosen = records[when]
            if chosen.size == 0:
                raise file.error("time", f"{when} holds none of the {len(times)} records")
            return chosen
        if when.step is not None:
            raise file.error("time", f"expected a slice of times without a step, got {when}")
        when = (when.start, when.stop)
    if isinstance(when, (list, tuple)):
        if len(when) != 2:
            raise file.error("time", f"expected the first and the last time, got {when!r}")
        first = 0 if when[0] is None else _record(file, times, when[0], dated)
        last = len(times) - 1 if when[1] is None else _record(file, times, when[1], dated)
        if first > last:
            raise file.error("time", f"expected the earlier time first, got {when!r}")
        return records[first : last + 1]
    return records[[_record(file, times, when, dated)]]


def _record(file: OceanFile, times: np.ndarray, moment: Any, dated: bool) -> int:
    if _is_index(moment):
        if not -len(times) <= moment < len(times):
            raise file.error("time", f"record {moment}: the file has 0 to {len(times) - 1}")
        return int(moment) % len(times)
    if not dated:
        raise file.error(
            "time", f"expected the index of a record, as they have no date, got {moment!r}"
        )
    wanted = _moment(file, moment)
    nearest = len(times) - 1 - int(np.abs(times - wanted)[::-1].argmin())
    slack = np.median(np.diff(times)) / 2 if len(times) > 1 else np.timedelta64(0, "ns")
    if abs(times[nearest] - wanted) > slack:
        first, last, closest = times[[0, -1, nearest]].astype("datetime64[s]")
        raise file.error(
            "time", f"{moment}: the nearest of the records from {first} to {last} is {closest}"
        )
    return nearest


def _moment(file: OceanFile, moment: Any) -> np.datetime64:
    try:
        if isinstance(moment, str):
            moment = datetime.datetime.fromisoformat(moment)
        if isinstance(moment, datetime.datetime) and moment.tzinfo is not None:
            moment = moment.astimezone(datetime.UTC).replace(tzinfo=None)
        wanted = np.datetime64(moment, "ns")
    except (TypeError, ValueError) as error:
        raise file.error(
            "time",
            f"expected an index or a date such as 2016-02-02T12:00, got {moment!r}",
        ) from error
    if np.isnat(wanted):
        raise file.error("time", f"expected a date, got {moment!r}")
    return wanted


def _is_index(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def _time_variable(file: OceanFile, dim: str | None) -> str | None:
    """The coordinate variable of the dimension, or another that gives the time on it."""
    variables = file.dataset.variables
    if dim is None:
        return next((n for n in _NAMES if n in variables and variables[n].size == 1), None)
    if dim in variables:
        return dim
    for name, variable in variables.items():
        units = str(variable.attrs.get("units", ""))
        if variable.dims == (dim,) and (" since " in units or str(name).lower() in _NAMES):
            return str(name)
    raise file.error(dim, "no variable gives the times of this dimension")


def _decode(file: OceanFile, name: str) -> Shaped[np.ndarray, " records"]:
    try:
        variable = file.dataset[[name]].reset_coords().variables[name]
        decoded = xr.decode_cf(xr.Dataset({"decoded": variable}))["decoded"].values.reshape(-1)
    except Exception as error:  # what a damaged file makes the libraries raise is not written
        units = file.dataset[name].attrs["units"]
        raise file.error(name, f"times in {units!r} cannot be read: {error}") from error
    if decoded.dtype.kind != "M":
        calendar = file.dataset[name].attrs.get("calendar")
        raise file.error(name, f"calendar: expected a standard one, got {calendar!r}")
    return decoded.astype("datetime64[ns]")
