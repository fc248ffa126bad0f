"""The times of the records of a file, and the choice of records."""

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
    "secs": 1, "min": 60, "mins": 60, "minute": 60, "minutes": 60,
    "h": 3600, "hr": 3600, "hrs": 3600, "hour": 3600, "hours": 3600,
    "d": 86400, "day": 86400, "days": 86400, "week": 604800, "weeks": 604800,
}  # fmt: skip
# Years whose nanoseconds fit 64 bits, with a margin.
_YEARS = range(1700, 2201)
# The calendars of CF, by patterns of the words that files use for them.
_CALENDARS = {
    ".*360.*": "360_day",
    ".*365.*|no_?.?leap.*": "noleap",
    ".*366.*|all_?.?leap.*": "all_leap",
    ".*proleptic.*": "proleptic_gregorian",
    "(standard|.*greg.*|none|)": "standard",
    "jul.*": "julian",
}
_DIGITS = re.compile("%Y%m%d|yyyymmdd", re.IGNORECASE)
# The largest time without a date, counted from 1970, whose nanoseconds fit 64 bits.
_MAX_SECONDS = 9.2e9
_NAME_IT = 'name a unit with time_units (--time-units "days since 2000-01-01")'


@dataclasses.dataclass(frozen=True)
class RecordTimes:
    values: Shaped[np.ndarray, " records"]
    "The time of each record, as datetime64."
    start: cftime.datetime | None = None
    "January 1 of the first record's year if the calendar is not standard; otherwise `None`."
    dated: bool = True
    "False if the file gives no date, so that times are counted from 1970-01-01."
    note: str = ""


def record_times(file: OceanFile, dim: str | None) -> RecordTimes:
    """Read the time of each record along a dimension, or the time of a single record."""
    name = time_variable(file, dim)
    if name is None:
        note = "time: the file has none; taken as 1970-01-01"
        return RecordTimes(np.zeros(1, "datetime64[ns]"), None, False, note)
    if file.dataset[name].size == 0:
        raise file.error(name, "expected a record or more, got none")
    times, start, note = read_times(file, name), None, ""
    dated = times.dtype.kind != "f"
    if not dated:
        seconds = np.where(np.abs(times) < _MAX_SECONDS, times, np.nan)
        times = np.datetime64(0, "ns") + np.round(seconds * 1e9).astype("timedelta64[ns]")
        note = f"{name}: {file.dataset[name].attrs['units']} without a date; counted from "
        note += "1970-01-01"
    elif times.dtype.kind == "O":
        first = times[0]
        if not isinstance(first, cftime.datetime):
            raise file.error(name, f"expected dates, got {first}")
        start = cftime.datetime(first.year, 1, 1, calendar=first.calendar)
        times = np.array([_since(start, date) for date in times])
        note = f"{name}: calendar {start.calendar}; the days since {first.year:04d}-01-01 are "
        note += f"counted from {_year(start)}-01-01"
    times = _in_nanoseconds(times)
    if (odd := np.isnat(times)).any():
        why = f"the time of record {int(odd.argmax())} is missing, or not from 1678 to 2261"
        raise file.error(name, why)
    if (backwards := np.diff(times) <= np.timedelta64(0, "ns")).any():
        k = int(backwards.argmax())
        got = f"got {times[k + 1]} after {times[k]} (record {k + 1})"
        raise file.error(name, f"expected times in order, {got}")
    return RecordTimes(times, start, dated, note)


def read_times(file: OceanFile, name: str) -> Shaped[np.ndarray, " records"]:
    """Read times as datetime64, as cftime in rare calendars, or in seconds if there is no date."""
    variable = file.dataset[name]
    if variable.dtype.kind in "MO":
        return variable.values.reshape(-1)
    units = str(variable.attrs.get("units", ""))
    # Climatologies count from the year 0, which the standard calendar does not have.
    dated = re.sub(r"since\s+0+-", "since 0001-", units.strip())
    calendar = _calendar(file, name) if " since " in dated else ""
    try:
        if _DIGITS.search(dated):
            days, part = np.divmod(file.read(variable).reshape(-1), 1)
            dates = [datetime.datetime.strptime(f"{day:.0f}", "%Y%m%d") for day in days]
            return np.array(dates, "datetime64[us]") + _lengths(part, np.timedelta64(1, "D"))
        if " since " in dated:
            return _counted(file.read(variable).reshape(-1), dated, calendar)
    except Exception as error:  # the exceptions for damaged files are not documented
        raise file.error(name, f"its times in {units!r} cannot be read; {_NAME_IT}") from error
    if units.lower() not in SECONDS:
        why = f"units: expected a unit of time since a date, got {units!r}; {_NAME_IT}"
        raise file.error(name, why)
    seconds = file.read(variable).reshape(-1) * SECONDS[units.lower()]
    if not np.isfinite(seconds).all():
        raise file.error(name, "a time is missing")
    return seconds


def _year(start: cftime.datetime) -> int:
    """The year from which days are counted: years such as 0 and 1 are of no date."""
    return start.year if start.year in _YEARS else 1970


def _since(start: cftime.datetime, date: cftime.datetime) -> np.datetime64:
    """Convert a non-standard date to a standard date, keeping the number of days since `start`."""
    return np.datetime64(f"{_year(start)}-01-01", "us") + np.timedelta64(date - start)


def _lengths(shares: np.ndarray, of: Any) -> np.ndarray:
    """Return the shares of lengths of time, in microseconds."""
    microseconds = shares * (of / np.timedelta64(1, "us"))
    return np.round(microseconds).astype("timedelta64[us]")


def _counted(values: np.ndarray, units: str, calendar: str) -> Shaped[np.ndarray, " records"]:
    """Decode numbers in `units` such as `days since 2000-01-01`.

    Months and years are those of the calendar, and a half is half of the month that it is in.
    """
    if match := re.match(r"(month|mon|year|yr)s?\s+(since .*)", units, re.IGNORECASE):
        months = values * (12 if match[1].lower().startswith("y") else 1)
        if calendar == "360_day":
            return _counted(30 * months, f"days {match[2]}", calendar)
        first = _counted(np.zeros(1), f"days {match[2]}", "proleptic_gregorian")[0]
        month = first.astype("datetime64[M]") + np.floor(months).astype("timedelta64[M]")
        begin, end = (m.astype("datetime64[us]") for m in (month, month + 1))
        return begin + (first - first.astype("datetime64[M]")) + _lengths(months % 1, end - begin)
    times = xr.Variable("time", values, {"units": units, "calendar": calendar})
    dates = xr.decode_cf(xr.Dataset({"decoded": times}))["decoded"].values
    if dates.dtype.kind == "M" and dates.astype("datetime64[Y]")[0].item().year < _YEARS[0]:
        return np.atleast_1d(cftime.num2date(values, units, "proleptic_gregorian"))
    return dates


def _calendar(file: OceanFile, name: str) -> str:
    """Return the calendar of times by its name in CF; other spellings are known by their words."""
    spelt = str(file.dataset[name].attrs.get("calendar", "standard")).strip()
    for word, calendar in _CALENDARS.items():
        if re.fullmatch(word, spelt, re.IGNORECASE):
            return calendar
    known = "standard, proleptic_gregorian, julian, 360_day, noleap or all_leap"
    way_on = f"name it with calendar (--calendar {known})"
    raise file.error(name, f"calendar: {spelt!r} is unknown; {way_on}")


def _in_nanoseconds(dates: Any) -> Any:
    """Convert dates to nanoseconds, with NaT outside the years 1678 to 2261."""
    fits = (dates >= np.datetime64("1678-01-01")) & (dates < np.datetime64("2262-01-01"))
    dates = np.array(dates)
    dates[~fits] = np.datetime64("NaT", "s")
    return dates.astype("datetime64[ns]")[()]


def read_period(when: Any) -> tuple[str, str] | None:
    """Return begin and end of a month `2020-03` or a period `2020-03-01/2020-03-11`, or `None`."""
    if not isinstance(when, str):
        return None
    if "/" in when:
        begin, _, end = when.partition("/")
        return begin, end
    if not re.fullmatch(r"\d{4}-(0[1-9]|1[0-2])", when):
        return None
    year, month = map(int, when.split("-"))
    return f"{when}-01", f"{year + month // 12:04d}-{month % 12 + 1:02d}-01"


def choose_records(file: OceanFile, times: RecordTimes, when: When) -> Int[np.ndarray, " chosen"]:
    """Find the records that the argument `time` of [`jaxcell.drift.open_currents`][] selects.

    Of two equally near records the later one is selected: a date means midnight, and so selects the
    daily mean that is dated at noon of the same day.
    """
    records = np.arange(len(times.values))
    if when is None:
        return records
    period = read_period(when)
    if period and "/" not in str(when) and times.dated:
        begin, end = (_moment(file, moment, times.start) for moment in period)
        if not (within := (times.values >= begin) & (times.values < end)).any():
            first, last = times.values[[0, -1]].astype("datetime64[D]")
            raise file.error("time", f"{when}: the records are from {first} to {last}")
        return records[within]
    when = period or when
    if isinstance(when, slice):
        if not (when.step is None or (_is_index(when.step) and when.step > 0)):
            raise file.error("time", f"expected a step of 1 or more, got {when}")
        if all(end is None or _is_index(end) for end in (when.start, when.stop)):
            if records[when].size == 0:
                raise file.error("time", f"{when} holds none of the {len(records)} records")
            return records[when]
        if when.step is not None:
            raise file.error("time", f"expected a slice of times without a step, got {when}")
        when = (when.start, when.stop)
    if not isinstance(when, (list, tuple)):
        return records[[_record(file, times, when)]]
    if len(when) != 2:
        raise file.error("time", f"expected the first and the last time, got {when!r}")
    first = 0 if when[0] is None else _record(file, times, when[0])
    last = len(records) - 1 if when[1] is None else _record(file, times, when[1])
    if first > last:
        raise file.error("time", f"expected the earlier time first, got {when!r}")
    return records[first : last + 1]


def _record(file: OceanFile, records: RecordTimes, moment: Any) -> int:
    times = records.values
    if _is_index(moment):
        if not -len(times) <= moment < len(times):
            raise file.error("time", f"record {moment}: the file has 0 to {len(times) - 1}")
        return int(moment) % len(times)
    if not records.dated:
        why = f"expected the index of a record, as they have no date, got {moment!r}"
        raise file.error("time", why)
    wanted = _moment(file, moment, records.start)
    nearest = len(times) - 1 - int(np.abs(times - wanted)[::-1].argmin())
    slack = np.median(np.diff(times)) / 2 if len(times) > 1 else np.timedelta64(0, "ns")
    if abs(times[nearest] - wanted) > slack:
        first, last, closest = times[[0, -1, nearest]].astype("datetime64[s]")
        why = f"{moment}: the nearest of the records from {first} to {last} is {closest}"
        raise file.error("time", why)
    return nearest


def _moment(file: OceanFile, moment: Any, start: cftime.datetime | None) -> np.datetime64:
    try:
        if start is not None:  # days such as 2001-02-30 exist in some calendars only
            parts = [int(part) for part in re.split(r"[-T :]", str(moment).removesuffix("Z"))]
            wanted = _since(start, cftime.datetime(*parts, calendar=start.calendar))
        else:
            if isinstance(moment, str):
                moment = datetime.datetime.fromisoformat(moment)
            if isinstance(moment, datetime.datetime) and moment.tzinfo is not None:
                moment = moment.astimezone(datetime.UTC).replace(tzinfo=None)
            wanted = np.datetime64(moment)
    except (TypeError, ValueError) as error:
        why = f"expected an index or a date such as 2016-02-02T12:00, got {moment!r}"
        raise file.error("time", why) from error
    wanted = _in_nanoseconds(wanted)
    if np.isnat(wanted):
        raise file.error("time", f"expected a date from 1678 to 2261, got {moment!r}")
    return wanted


def _is_index(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def time_variable(file: OceanFile, dim: str | None) -> str | None:
    """Find the variable with the times along `dim`, or with a single time if `dim` is `None`."""
    variables = file.dataset.variables
    names = next(table("time")).names
    if dim is None:
        return next((n for n in names if n in variables and variables[n].size == 1), None)
    if dim in variables:
        return dim
    for name in map(str, variables):
        if variables[name].dims == (dim,) and is_time(file.dataset, name):
            return name
    why = "no variable gives the times of this dimension"
    raise file.error(dim, f"{why}; to count its records, {_NAME_IT}")


def is_time(dataset: xr.Dataset, name: str) -> bool:
    """Return whether a variable has times, by its unit, its type or its name."""
    variable = dataset.variables[name]
    dated = " since " in str(variable.attrs.get("units", "")) or variable.dtype.kind == "M"
    return dated or name.lower() in next(table("time")).names
