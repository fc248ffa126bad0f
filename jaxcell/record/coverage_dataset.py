from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from ..bounce import CoveragePolicy
from ..space import CellSpace
from .checks import coverage_checks, with_checks
from .provenance import angle_attributes, cell_coordinates, provenance


def coverage_dataset(
    cells: CellSpace,
    policy: CoveragePolicy,
    *,
    bounces: Float[np.ndarray, "angles"],
    spec: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """A mixture of bouncing policies as a labelled dataset.

    Over `bounce`: `alpha`, the number of persistent `groups` and the `residual` of the limiting
    distribution. Over `position`: `mixture` and `target`; over both, `coverage`; and over
    `direction` too, `limiting` and `group`, the persistent group of each cell (-1 if transient).
    Over `group_index`: `group_weight` and `group_size`; where an angle has fewer groups than
    another, its last entries are 0.

    `dataset.mixture.set_index(position=("y", "x")).unstack()` is the picture of the mixture.

    **Arguments:**

    - `cells`: the cell space.
    - `policy`: the mixture.
    - `bounces`: the bouncing angles, in radians.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the policy is not of these cells or angles, or if `spec` is not
    JSON; `RuntimeError` if it contradicts itself.

    A corridor of three cells, and robots that turn by a quarter or half a turn:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> bounces = [math.pi / 2, math.pi]
        >>> policy = bounce.coverage_policy(cells, bounces, error=0.0, reliability=1.0)
        >>> dataset = record.coverage_dataset(cells, policy, bounces=np.array(bounces))
        >>> dataset.coverage.sizes["bounce"], dataset.alpha.values.round(3).tolist()
        (2, [0.0, 1.0])
        >>> dataset.mixture.values.round(3).tolist()
        [0.333, 0.333, 0.333]
    """
    check_policy(cells, policy, bounces)
    share = {"units": "1", "long_name": "share of time in the long run"}
    shape = (len(bounces), cells.directions, cells.positions)
    most = max(groups.count for groups in policy.groups)

    def over_groups(values: list[Any]) -> np.ndarray:
        padded = np.zeros((len(values), most), np.asarray(values[0]).dtype)
        for row, value in zip(padded, values, strict=True):
            row[: len(value)] = value
        return padded

    limiting = np.stack([one.value for one in policy.limiting]).reshape(shape)
    group = np.stack([one.group for one in policy.groups]).reshape(shape)
    attributes = provenance("Coverage by a mixture of bouncing policies", cells, spec)
    dataset = xr.Dataset(
        {
            "alpha": ("bounce", np.asarray(policy.alpha), {"long_name": "share of time", **share}),
            "groups": ("bounce", np.array([one.count for one in policy.groups], np.int32)),
            "residual": (
                "bounce",
                np.array([one.certificate.residual for one in policy.limiting]),
                {"long_name": "1-norm of what a step changes of the limiting distribution"},
            ),
            "mixture": ("position", np.asarray(policy.mixture), share),
            "target": (
                "position",
                np.asarray(policy.target),
                {"long_name": "wanted", "units": "1"},
            ),
            "coverage": (("bounce", "position"), np.asarray(policy.coverage), share),
            "limiting": (("bounce", "direction", "position"), limiting, share),
            "group": (
                ("bounce", "direction", "position"),
                group,
                {"long_name": "persistent group, -1 if transient"},
            ),
            "group_weight": (
                ("bounce", "group_index"),
                over_groups([one.weights for one in policy.limiting]),
                {"long_name": "probability of ending in the group", "padding": "0"},
            ),
            "group_size": (
                ("bounce", "group_index"),
                over_groups([one.size for one in policy.groups]),
                {"long_name": "cells of the group", "padding": "0"},
            ),
        },
        coords={
            "bounce": ("bounce", bounces, angle_attributes("bouncing angle")),
            "bounce_deg": ("bounce", np.rad2deg(bounces), {"units": "degree"}),
            **cell_coordinates(cells),
        },
        attrs={
            **attributes,
            "distance": policy.distance,
            "total_variation": policy.total_variation,
            "duality_gap": policy.certificate.residual,
        },
    )
    return with_checks(dataset, coverage_checks(dataset))


def check_policy(
    cells: CellSpace, policy: CoveragePolicy, bounces: Float[np.ndarray, "angles"]
) -> None:
    """Raises `ValueError` if a policy is not of these cells and angles."""
    if policy.coverage.shape != (len(bounces), cells.positions):
        raise ValueError(
            f"policy: expected one of {len(bounces)} angles and {cells.positions} positions, got "
            f"{policy.coverage.shape[0]} and {policy.coverage.shape[1]}"
        )
    if policy.groups[0].group.shape != (cells.size,):
        raise ValueError(
            f"policy: expected one of {cells.size} cells, got {policy.groups[0].group.shape[0]}"
        )
