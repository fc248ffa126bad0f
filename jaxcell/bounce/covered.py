import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate
from ..base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ..mapping import PersistentGroups
from ..markov import LimitingDistribution
from ..space import CellSpace


@dataclasses.dataclass(frozen=True, eq=False)
class CoveragePolicy(Result):
    """How a robot should divide its time among bouncing angles to cover a room as wanted."""

    title: ClassVar[str] = "Coverage by a mixture of bouncing policies"
    picture: ClassVar[str] = "mixture"
    tables: ClassVar[Mapping[str, str]] = {"bounce": "policies"}

    cells: CellSpace
    bounce: Annotated[
        Float[np.ndarray, "angles"],
        quantity("bounce", "bouncing angle", "rad", kind="coordinate", sense="counter-clockwise"),
    ]
    alpha: Annotated[
        Float[Array, "angles"],
        quantity("bounce", "share of time", "1", kind="distribution", source="Alam 2018, Eq. 3.7"),
    ]
    coverage: Annotated[
        Float[Array, "angles positions"],
        quantity("bounce position", "share of time in the long run", "1", kind="distribution"),
    ]
    mixture: Annotated[
        Float[Array, "positions"],
        quantity("position", "share of time of the mixture", "1", kind="distribution"),
    ]
    target: Annotated[
        Float[Array, "positions"],
        quantity("position", "share of time that is wanted", "1", kind="distribution"),
    ]
    distance: Annotated[float, quantity("", "Euclidean distance of the mixture from the target")]
    certificate: Certificate
    "That of the mixture; see [`jaxcell.optimize.mixture`][]."
    groups: tuple[PersistentGroups, ...]
    "The persistent groups of each angle."
    limiting: tuple[LimitingDistribution, ...]
    "The limiting distribution of each angle over all cells, with its certificate."

    @derived("", "time spent elsewhere than wanted", kind="share")
    def total_variation(self) -> float:
        return float(jnp.abs(self.mixture - self.target).sum() / 2)

    @derived("", "positions visited in the long run", kind="count")
    def positions_visited(self) -> int:
        return int((np.asarray(self.mixture) > 0).sum())

    @derived("", "bouncing angles with a share of time", kind="count")
    def angles_used(self) -> int:
        return int((np.asarray(self.alpha) > 0).sum())

    @derived("", "persistent groups of all angles", kind="count")
    def groups_in_all(self) -> int:
        return sum(int(one.count) for one in self.groups)

    @derived("", "duality gap, relative", kind="residual")
    def duality_gap(self) -> float:
        return float(self.certificate.residual)

    @derived("bounce", "bouncing angle", "degree", kind="coordinate")
    def bounce_deg(self) -> Float[np.ndarray, "angles"]:
        return np.rad2deg(self.bounce)

    @derived("bounce", "persistent groups", kind="count")
    def persistent_groups(self) -> Int[np.ndarray, "angles"]:
        return np.array([one.count for one in self.groups])

    @derived("bounce", "cells of persistent groups", kind="count")
    def persistent_cells(self) -> Int[np.ndarray, "angles"]:
        return np.array([int(one.size.sum()) for one in self.groups])

    @derived("bounce", "positions visited by one angle alone", kind="count")
    def positions_alone(self) -> Int[np.ndarray, "angles"]:
        return (np.asarray(self.coverage) > 0).sum(axis=1)

    @derived("bounce", "what a step changes of the limiting distribution", kind="residual")
    def stationarity_residual(self) -> Float[np.ndarray, "angles"]:
        return np.array([one.certificate.residual for one in self.limiting])

    @derived(
        "bounce direction position",
        "share of time in the long run",
        "1",
        kind="distribution",
        over="direction position",
    )
    def share(self) -> Float[np.ndarray, "angles directions positions"]:
        return self._by_direction([one.value for one in self.limiting])

    @derived("bounce direction position", "persistent group, -1 if transient", kind="index")
    def group(self) -> Int[np.ndarray, "angles directions positions"]:
        return self._by_direction([one.group for one in self.groups])

    @derived("bounce group_index", "probability of ending in the group", kind="distribution")
    def group_weight(self) -> Float[np.ndarray, "angles groups"]:
        return _padded([one.weights for one in self.limiting])

    @derived("bounce group_index", "cells of the group, 0 where an angle has fewer", kind="count")
    def group_size(self) -> Int[np.ndarray, "angles groups"]:
        return _padded([one.size for one in self.groups])

    def checks(self) -> Checks:
        alpha, coverage = np.asarray(self.alpha), np.asarray(self.coverage)
        transient = np.where(self.group < 0, self.share, 0).sum(axis=(1, 2))
        counted = [
            np.bincount(one[one >= 0], minlength=self.group_size.shape[1])
            for one in self.group.reshape(len(alpha), -1)
        ]
        return {
            "stationarity_residual": (float(self.stationarity_residual.max()), PROBABILITY),
            "group_sizes": (int(np.abs(counted - self.group_size).max()), 0),
            "share_of_transient_cells": (float(transient.max()), PROBABILITY),
            "coverage_is_of_share": (
                float(np.abs(self.share.sum(axis=1) - coverage).max()),
                PROBABILITY,
            ),
            "mixture_is_of_coverage": (
                float(np.abs(alpha @ coverage - np.asarray(self.mixture)).max()),
                PROBABILITY,
            ),
        }

    def _by_direction(self, values: list[Any]) -> np.ndarray:
        shape = (len(values), self.cells.directions, self.cells.positions)
        return np.stack(values).reshape(shape)


def _padded(rows: list[Any]) -> np.ndarray:
    """Rows of different lengths as a matrix, with 0 for what is missing."""
    padded = np.zeros((len(rows), max(map(len, rows))), np.asarray(rows[0]).dtype)
    for line, row in zip(padded, rows, strict=True):
        line[: len(row)] = row
    return padded
