import dataclasses
import functools
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from ..base.optional_modules import import_module
from ..base.shown import Shown
from .formats.storage import reading, write_arrays


if TYPE_CHECKING:
    import scipy.sparse


# Probabilities are stored in files as whole multiples of this number.
_UNIT = 2.0**-30
# The share of cells with positive weight below which matrix products skip the other cells.
_FEW = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class HiddenMap(Shown):
    """A hidden Markov model: a map with several images per cell, and an observation at each move.

    A *configuration* is a set of cells that need not be distinguished. Estimates are therefore sets
    of configurations.

    The first two of three cells are one configuration. A robot moves on or stays, and bumps at the
    end:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 0]])
        >>> bumps = np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.array([0, 0, 1]), np.ones(3) / 3)
        >>> hidden.cells, hidden.configurations
        (3, 2)
    """

    moves: "scipy.sparse.csr_array"
    "The probability of a step, observation 0, from the cell of a row to the cell of a column."
    bumps: "tuple[scipy.sparse.csr_array, ...]"
    "The probabilities of bumps, as in `moves`, for each angle by which the robot may turn."
    configuration: Int[np.ndarray, "cells"]
    "The number of the configuration that contains each cell."
    start: Float[np.ndarray, "cells"]
    "The probability of each cell at the start."
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    "A JSON object that is stored with the map."

    @classmethod
    def of(
        cls,
        moves: Any,
        bumps: Any,
        configuration: Int[np.ndarray, "cells"],
        start: Float[np.ndarray, "cells"],
        metadata: Mapping[str, Any] | None = None,
    ) -> "HiddenMap":
        """Create a map from its fields; matrices may be dense, and `bumps` a single matrix."""
        # A robot that runs a filter does not need SciPy.
        sparse = import_module("scipy.sparse")
        several = bumps if isinstance(bumps, list | tuple) else [bumps]
        parts = [sparse.csr_array(m, dtype=np.float64) for m in (moves, *several)]
        cells = start.size
        for part in parts:
            if part.shape != (cells, cells):
                raise ValueError(
                    f"moves, bumps: expected {cells} rows and columns, as many as start has "
                    f"numbers, got {part.shape}"
                )
        if configuration.shape != (cells,) or configuration.min() < 0:
            raise ValueError(f"configuration: expected {cells} numbers from 0")
        negative = min(part.data.min(initial=0) for part in parts)
        free, *walls = (np.asarray(part.sum(axis=1)).ravel() for part in parts)
        if not (negative >= 0 and (free + walls[0]).max() <= 1 + 1e-6):
            raise ValueError("moves, bumps: expected rows of probabilities that sum to at most 1")
        if any(np.abs(wall - walls[0]).max() > 1e-6 for wall in walls[1:]):
            raise ValueError("bumps: expected the same probability of a bump for each angle")
        # Each probability is rounded in a file.
        off = abs(start.sum() - 1) - cells * _UNIT / 2
        if not (start.min() >= 0 and off < 1e-6):
            raise ValueError("start: expected a distribution")
        configuration = configuration.astype(np.int32)
        return cls(parts[0], tuple(parts[1:]), configuration, start, dict(metadata or {}))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.start.size

    @functools.cached_property
    def configurations(self) -> int:
        """Number of configurations."""
        return int(self.configuration.max()) + 1

    @property
    def angles(self) -> int:
        """Number of angles by which the robot may turn at a bump."""
        return len(self.bumps)

    def leaving(self, event: int) -> "scipy.sparse.csr_array":
        """Return the matrix of joint probabilities of an event and a move between two cells.

        Event 0 is a step, and event `1 + i` is a bump and the turn by angle `i`. With one angle,
        events are observations. Rows are cells before the event, and columns cells after it.
        """
        return (self.moves, *self.bumps)[event]

    def after(self, event: int, weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
        """Compute the joint probability of an event and of each cell after it.

        Events are numbered as in `leaving`; `weight` is the probability of each cell before it.
        """
        leaving, here = self.leaving(event), np.flatnonzero(weight > 0)
        if here.size < _FEW * weight.size:
            leaving, weight = leaving[here], weight[here]
        return leaving.T @ weight

    def masses(self, weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "configurations"]:
        """Compute the sum of the weights of the cells in each configuration."""
        return np.bincount(self.configuration, weight, self.configurations)

    def by_position(
        self, weight: Float[np.ndarray, "cells"], positions: int
    ) -> Float[np.ndarray, "positions"]:
        """Compute the sum of the weights of the cells at each position, over all headings."""
        return np.bincount(self.configuration % positions, weight, positions)

    @functools.cached_property
    def bumping(self) -> Float[np.ndarray, "cells"]:
        """The probability of a bump at the next step from each cell."""
        return np.asarray(self.bumps[0].sum(axis=1)).ravel()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to a file, replacing any existing file."""
        arrays = {"configuration": self.configuration, "start": _whole(self.start)}
        for name, matrix in zip(_names(self.angles), (self.moves, *self.bumps), strict=True):
            arrays |= {
                f"{name}_indptr": matrix.indptr.astype(np.int32),
                f"{name}_indices": matrix.indices.astype(np.int32),
                f"{name}_data": _whole(matrix.data),
            }
        write_arrays(path, {"kind": "hidden map", "metadata": dict(self.metadata)}, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "HiddenMap":
        """Read a map that [`HiddenMap.save`][] wrote."""
        sparse = import_module("scipy.sparse")
        with reading(path, "hidden map") as (header, arrays):
            start = arrays["start"] * _UNIT
            matrices = []
            angles = sum(name.endswith("_indptr") for name in arrays) - 1
            for name in _names(angles):
                parts = [arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr")]
                matrix = sparse.csr_array(
                    (parts[0] * _UNIT, *parts[1:]), shape=(start.size, start.size)
                )
                matrix.check_format()
                matrices.append(matrix)
            moves, *bumps = matrices
            return cls.of(moves, bumps, arrays["configuration"], start, header["metadata"])


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate(Shown):
    """The possible configurations of a robot, with their probabilities."""

    cells: Int[np.ndarray, "configurations"]
    "The configurations, the likeliest first if probabilities are known."
    probability: Float[np.ndarray, "configurations"]
    "The probability of each configuration, given that the robot is on the map; equal if unknown."
    nowhere: float
    "The probability, from 0 to 1, that the robot is nowhere on the map."


def credible(mass: Float[np.ndarray, "configurations"], share: float, nowhere: float) -> Estimate:
    """Find the credible set: the fewest configurations that contain a share of the probability.

    **Arguments:**

    - `mass`: the probability of each configuration, up to a factor.
    - `share`: the minimum share of the total probability that the credible set must contain.
    - `nowhere`: the probability that the robot is in no configuration.

    **Returns:** [`Estimate`][], with no configurations if all masses are 0.

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> automata.credible(np.array([0.1, 0.6, 0.3]), 0.8, 0.0).cells.tolist()
        [1, 2]
    """
    here = mass.sum()
    if here == 0:
        return Estimate(np.empty(0, np.int32), np.empty(0), nowhere)
    order = np.argsort(-mass, kind="stable")
    mass = mass[order] / here
    # Rounding must not make a share of 1 include configurations with mass 0.
    count = int(np.searchsorted(np.cumsum(mass), share * (1 - 1e-12))) + 1
    count = min(count, int(np.count_nonzero(mass)))
    return Estimate(order[:count].astype(np.int32), mass[:count], nowhere)


def _names(angles: int) -> list[str]:
    return ["moves", "bumps", *(f"bumps_{i}" for i in range(1, angles))]


def _whole(share: Float[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
    return np.asarray(np.rint(share / _UNIT), np.int32)
