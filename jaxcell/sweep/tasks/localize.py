"""The localization filter of a map, as `jaxcell localize`."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .maps import MAP, MOTION, cells_of, motion_of
from .parameters import Parameter, angle, members
from .results import dataset


PARAMETERS = {**MAP, "bounce": Parameter(angle), **MOTION}
_RESULTS = {
    "nfa_states": ("states of the nondeterministic automaton", "1"),
    "dfa_states": ("states of the filter", "1"),
    "minimal_states": ("states of the smallest filter of the same colours", "1"),
    "knowledge_cycles": ("number of knowledge cycles", "1"),
    "least_uncertainty": ("cells left possible in the end, at best", "1"),
    "largest_uncertainty": ("cells left possible in the end, at worst", "1"),
}


def localize(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Sizes of localization filters, and how certain of its cell a robot becomes.

    Parameters: those of `jaxcell localize` that determine the filter, with `bounce` in degrees.
    Nothing is random.
    """
    return dataset(
        _RESULTS, [_row(member) for member in members("localize", PARAMETERS, batch, fixed)]
    )


def _row(member: dict[str, Any]) -> tuple[int, ...]:
    from ...automata import minimize
    from ...bounce import bounce_map, localization_filter

    cells = cells_of(member)
    filter = localization_filter(
        bounce_map(cells, math.radians(member["bounce"]), **motion_of(member))
    )
    uncertainty = [cycle.uncertainty for cycle in filter.cycles]
    return (
        cells.size + 1,
        len(filter.transition),
        len(minimize(filter).transition),
        len(uncertainty),
        min(uncertainty),
        max(uncertainty),
    )
