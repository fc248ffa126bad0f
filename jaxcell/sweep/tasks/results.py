"""How tasks give their results."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr


def dataset(
    told: Mapping[str, tuple[str, str]], rows: Sequence[Sequence[float | int]]
) -> xr.Dataset:
    """A row of numbers for each member as a Dataset.

    **Arguments:**

    - `told`: what each number is called, says, and is measured in.
    - `rows`: the numbers of each member.
    """
    columns = zip(*rows, strict=True)
    return xr.Dataset(
        {
            name: ("member", np.array(column), {"long_name": long_name, "units": units})
            for (name, (long_name, units)), column in zip(told.items(), columns, strict=True)
        }
    )


def together(
    members: Sequence[dict[str, Any]],
    alike: Callable[[dict[str, Any]], Hashable],
    rows: Callable[[list[dict[str, Any]]], Sequence[Sequence[float | int]]],
) -> list[Sequence[float | int]]:
    """A row of numbers for each member, where those that are alike are one call.

    **Arguments:**

    - `members`: the parameters of each member.
    - `alike`: what members of one call have in common.
    - `rows`: the numbers of such members, one or more.
    """
    calls: dict[Hashable, list[int]] = {}
    for i, member in enumerate(members):
        calls.setdefault(alike(member), []).append(i)
    found: list[Sequence[float | int]] = [()] * len(members)
    for some in calls.values():
        for i, row in zip(some, rows([members[i] for i in some]), strict=True):
            found[i] = row
    return found


def but(name: str) -> Callable[[dict[str, Any]], Hashable]:
    """Members are alike if they differ in this parameter alone."""
    return lambda member: tuple(value for key, value in member.items() if key != name)
