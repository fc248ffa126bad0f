"""Run a study as the task of a sweep, with different parameters for each member."""

import dataclasses
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

from ..base.quantities import Quantity, Result, values
from ..study import Study


if TYPE_CHECKING:
    import xarray as xr


Asked = TypeVar("Asked", bound=Study)


def read_study(study: type[Asked], parameters: Mapping[str, Any]) -> Asked:
    """Create a study from parameters read from TOML or JSON; a tuple may be given as one value."""
    known = {field.name: field for field in dataclasses.fields(study)}
    named = ", ".join(known)
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


def study_task(
    study: type[Study], batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int
) -> "xr.Dataset":
    """Compute the scalar quantities of a study for each member of a batch.

    Members that differ only in the parameter that `Study.batch` names are computed together.
    """
    import xarray as xr

    members = studies(study, batch, fixed, seed)
    rows: list[dict[str, tuple[Quantity, Any]]] = [{}] * len(members)
    for together in _together(study, members):
        for i, row in zip(together, _rows([members[i] for i in together]), strict=True):
            rows[i] = row
    dataset = xr.Dataset()
    # If a member does not have a number, NaN stands in its place.
    for name, about in {name: row[name][0] for row in rows for name in row}.items():
        attributes = {"long_name": about.meaning, "units": about.units or "1"}
        column = [row[name][1] if name in row else np.nan for row in rows]
        dataset[name] = ("member", np.array(column), attributes)
    return dataset


def studies(
    study: type[Asked], batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int
) -> list[Asked]:
    """Create the study of each member of a batch, by default with the seed of the sweep."""
    names = {field.name for field in dataclasses.fields(study)}
    fixed = {"seed": seed, **fixed} if "seed" in names and "seed" not in batch else dict(fixed)
    columns = [column.tolist() for column in batch.values()]
    rows = zip(*columns, strict=True) if columns else [()]
    return [read_study(study, {**fixed, **dict(zip(batch, row, strict=True))}) for row in rows]


def _together(study: type[Study], members: Sequence[Study]) -> list[list[int]]:
    """Group the indices of the members that can be computed together, as one study."""
    if study.batch is None:
        return [[i] for i in range(len(members))]
    alike: dict[Hashable, list[int]] = {}
    for i, member in enumerate(members):
        names = (field.name for field in dataclasses.fields(study) if field.name != study.batch)
        alike.setdefault(tuple(getattr(member, name) for name in names), []).append(i)
    return list(alike.values())


def _rows(alike: Sequence[Study]) -> list[dict[str, tuple[Quantity, Any]]]:
    batch = alike[0].batch
    if batch is None:
        return [_numbers(one.run(), ()) for one in alike]
    several = tuple(value for one in alike for value in getattr(one, batch))
    numbers = _numbers(dataclasses.replace(alike[0], **{batch: several}).run(), (batch,))
    return [
        {
            name: (about, value[i] if about.dims else value)
            for name, (about, value) in numbers.items()
        }
        for i in range(len(alike))
    ]


def _numbers(result: Result, dims: tuple[str, ...]) -> dict[str, tuple[Quantity, Any]]:
    """Select the quantities of a result that are numbers, or numbers along `dims`."""
    described = values(
        result, lambda about: about.dims in ((), dims) and about.kind != "coordinate"
    )
    arrays = {name: (about, np.asarray(value)) for name, (about, value) in described.items()}
    return {name: one for name, one in arrays.items() if one[1].dtype.kind in "biuf"}


def _path(kind: type, value: Any) -> Any:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError
