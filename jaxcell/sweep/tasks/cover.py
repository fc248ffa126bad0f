"""The coverage of a map by an imprecise robot, as `jaxcell cover`."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .maps import MAP, MOTION, cells_of, motion_of
from .parameters import Parameter, angle, members, number, numbers, one_of, whole
from .results import dataset


PARAMETERS = {
    **MAP,
    "directions": Parameter(whole(1), 360),
    **MOTION,
    "bounces": Parameter(numbers),
    "error": Parameter(angle),
    "reliability": Parameter(number("above 0 and at most 1", lambda x: 0 < x <= 1)),
    "weights": Parameter(one_of("basin", "size"), "basin"),
}
_RESULTS = {
    "distance": ("Euclidean distance of the coverage from an even one", "1"),
    "total_variation": ("time spent elsewhere than wanted", "1"),
    "positions_visited": ("positions visited in the long run", "1"),
    "angles_used": ("bouncing angles with a share of time", "1"),
    "persistent_groups": ("persistent groups of all angles", "1"),
    "duality_gap": ("duality gap of the shares", "1"),
}


def cover(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """How evenly a robot covers a map with the best shares of time of its bouncing angles.

    Parameters: the options of `jaxcell cover`, angles in degrees; `bounces` is a list of them, or
    one. The target is uniform. Nothing is random.
    """
    return dataset(
        _RESULTS, [_row(member) for member in members("cover", PARAMETERS, batch, fixed)]
    )


def _row(member: dict[str, Any]) -> tuple[float | int, ...]:
    from ...bounce import coverage_policy

    policy = coverage_policy(
        cells_of(member),
        np.radians(member["bounces"]),
        math.radians(member["error"]),
        member["reliability"],
        weights=member["weights"],
        **motion_of(member),
    )
    return (
        float(policy.distance),
        float(policy.total_variation),
        int((np.asarray(policy.mixture) > 0).sum()),
        int((np.asarray(policy.alpha) > 0).sum()),
        sum(int(groups.count) for groups in policy.groups),
        float(policy.certificate.residual),
    )
