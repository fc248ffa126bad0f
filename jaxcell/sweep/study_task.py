"""Run a study as the task of a sweep, with different parameters for each member."""

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from ..base.formatting import did_you_mean
from ..base.quantities import Quantity
from ..study import Study
from ..study.study import every


Asked = TypeVar("Asked", bound=Study)


class WrongResultsError(ValueError):
    """The names of the wanted quantities include one that no member has."""


def read_study(study: type[Asked], parameters: Mapping[str, Any]) -> Asked:
    """Create a study from parameters read from TOML or JSON; a tuple may be given as one value.

    `errors_turn = 5.0` is one of the `errors`, turn=5.0, and `params_T = 0.5` one of the `params`.
    """
    known = {field.name: field for field in dataclasses.fields(study)}
    named = ", ".join(known)
    for texts in {"errors", "params"} & known.keys():
        own = {name: one for name, one in parameters.items() if name.startswith(f"{texts}_")}
        more = {name.removeprefix(f"{texts}_"): one for name, one in own.items()}
        parameters = {name: one for name, one in parameters.items() if name not in own}
        if more:
            given = parameters.get(texts, [])
            listed = given if isinstance(given, list) else [given]
            for text in listed:
                if (twice := str(text).partition("=")[0].strip()) in more:
                    raise ValueError(
                        f"{texts}: {twice} is given twice, by {text!r} and by {texts}_{twice}"
                    )
            parameters[texts] = [*listed, *(f"{name}={one}" for name, one in more.items())]
    for name in parameters:
        if name not in known:
            raise ValueError(f"{name}: expected a parameter of {study.__name__}, one of {named}")
    given = dict(parameters)
    for name, field in known.items():
        needed = (
            dataclasses.MISSING is field.default and dataclasses.MISSING is field.default_factory
        )
        if name not in given and needed:
            raise ValueError(f"{name}: {study.__name__} needs this parameter; it has {named}")
        if name in given and "tuple" in str(field.type) and not isinstance(given[name], list):
            given[name] = [given[name]]
    try:
        return msgspec.convert(given, study, strict=True, dec_hook=_path)
    except msgspec.ValidationError as error:
        what, _, place = str(error).partition(" - at `$.")
        name = place.rstrip("`").partition("[")[0]
        if name in given:
            lowered = what[:1].lower() + what[1:].replace("`", "")
            raise ValueError(f"{name}: {lowered}: {given[name]!r}") from None
        raise ValueError(str(error)) from None


def member_study(study: type[Asked], parameters: Mapping[str, Any], seed: int) -> Asked:
    """Create the study of a member, by default with the seed of the sweep."""
    seeded = any(field.name == "seed" for field in dataclasses.fields(study))
    return read_study(study, {"seed": seed, **parameters} if seeded else parameters)


def study_task(
    study: type[Study],
    batch: Mapping[str, np.ndarray],
    fixed: Mapping[str, Any],
    seed: int,
    results: Sequence[str] = (),
) -> dict[str, tuple[str, np.ndarray, dict[str, str]]]:
    """Compute the scalar quantities of a study for each member of a batch.

    `results` are the names of the quantities, by default all. Members that differ only in
    parameters in `Study.varied` are computed together. **Returns:** the variables of a Dataset:
    xarray, whose import takes longer than that of JAX, is not imported.
    """
    members, known = _members(batch), dict[str, None]()

    def wanted(name: str) -> bool:
        known[name] = None
        return name in results

    found: dict[str, tuple[Quantity, list[tuple[np.ndarray, np.ndarray]]]] = {}
    for rows, one, columns in _together(study, batch, fixed, seed):
        numbers = one.numbers(columns, wanted if results else every)
        for name, (about, value) in numbers.items():
            found.setdefault(name, (about, []))[1].append((rows, value))
    if missing := [name for name in results if name not in found]:
        meant = did_you_mean(missing[0], known)
        raise WrongResultsError(
            f"results: {study.__name__} has no number {missing[0]!r}{meant}; without `results` a "
            "sweep has all of them"
        )
    variables = {}
    for name, (about, parts) in found.items():
        # If a member does not have a number, NaN stands in its place.
        whole = sum(rows.size for rows, _ in parts) == members
        kind = np.result_type(*(value for _, value in parts), *([] if whole else [float]))
        column = np.zeros(members, kind) if whole else np.full(members, np.nan)
        for rows, value in parts:
            column[rows] = value
        attributes = {"long_name": about.meaning, "units": about.units or "1"}
        variables[name] = ("member", column, attributes)
    return variables


def check_members(
    study: type[Study], batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int
) -> None:
    """Raise `ValueError` for a wrong parameter of a member."""
    _together(study, batch, fixed, seed)


def check_files(
    study: type[Study], members: Iterable[tuple[str, Mapping[str, Any]]], seed: int
) -> None:
    """Raise `ValueError` if a file is missing or cannot be read.

    `members` are pairs of the name of a file, and the parameters of a member with it. Other wrong
    parameters are errors only if this name is empty.
    """
    for file, given in members:
        try:
            member = member_study(study, given, seed)
            member.check_files()
            # The workers may have more memory.
            with contextlib.suppress(MemoryError):
                member.memory()
        except (OSError, ValueError) as error:
            if isinstance(error, OSError) or str(error).startswith(file):
                raise ValueError(str(error)) from error


def _members(batch: Mapping[str, np.ndarray]) -> int:
    return len(next(iter(batch.values()))) if batch else 1


def _together(
    study: type[Asked], batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int
) -> list[tuple[np.ndarray, Asked, dict[str, np.ndarray]]]:
    """Group the members that can be computed together.

    **Returns:** for each group the indices of its members, the study of the first, and the columns
    of the parameters in which the others differ from it.
    """
    several = tuple(f"{name}_" for name in study.varied)
    varied = {
        name: column
        for name, column in batch.items()
        if (name in study.varied or name.startswith(several)) and column.dtype.kind in "iuf"
    }
    codes = [
        np.unique(column, return_inverse=True)[1]
        for name, column in batch.items()
        if name not in varied
    ]
    kind = np.zeros(_members(batch), np.intp)
    if codes:
        kind = np.unique(np.stack(codes), axis=1, return_inverse=True)[1].reshape(-1)
    order = np.argsort(kind, kind="stable")
    groups = []
    for rows in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
        of_first = {name: column[rows[0]].item() for name, column in batch.items()}
        one = member_study(study, {**fixed, **of_first}, seed)
        columns = {name: column[rows] for name, column in varied.items()}
        # Bounds are intervals, so all values are within them if the extremes are.
        for name, column in columns.items():
            for extreme in (column.min().item(), column.max().item()):
                member_study(study, {**fixed, **of_first, name: extreme}, seed)
        groups.append((rows, one, columns))
    return groups


def _path(kind: type, value: Any) -> Any:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError
