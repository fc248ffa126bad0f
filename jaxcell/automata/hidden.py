import dataclasses
import functools
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from ..base.documents import Fields
from ..base.extras import import_module
from .formats.storage import read_arrays, write_arrays


if TYPE_CHECKING:
    import scipy.sparse


_FORMAT, _VERSION = "jaxcell-hidden-map", 1
# Probabilities are kept in a file as whole numbers of these.
_UNIT = 2.0**-30
FEW = 0.2
"From so few of the cells their rows are followed one by one, from more the whole matrix."


@dataclasses.dataclass(frozen=True, eq=False)
class HiddenMap:
    """A map with several images of each cell, and what the robot senses on the way to each.

    Cells may be finer than those of which one asks, the *configurations*.

    Of three cells, the first two one configuration, a robot goes to the next or stays, and bumps at
    the end:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 0]])
        >>> bumps = np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.array([0, 0, 1]), np.ones(3) / 3)
        >>> hidden.cells, hidden.configurations
        (3, 2)
    """

    moves: "scipy.sparse.csr_array"
    "The probability of going from a cell, the row, to another with observation 0."
    bumps: "tuple[scipy.sparse.csr_array, ...]"
    "The same with observation 1, for each of the angles that the robot may turn by."
    configuration: Int[np.ndarray, "cells"]
    "The configuration that each cell is in."
    start: Float[np.ndarray, "cells"]
    "The distribution over the cells in the beginning."
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    "What else is known of it, a JSON object."

    @classmethod
    def of(
        cls,
        moves: Any,
        bumps: Any,
        configuration: Int[np.ndarray, "cells"],
        start: Float[np.ndarray, "cells"],
        metadata: Mapping[str, Any] | None = None,
    ) -> "HiddenMap":
        """**Arguments:** those of the fields; the matrices may be dense, and of bumps there may be
        one matrix, for a robot with one angle, or a list of several.

        **Raises:** `ValueError` for arrays that do not fit each other, probabilities that are
        negative, or that sum to more than 1, and bumps whose probability depends on the angle.
        """
        # A robot that carries a filter has no need of SciPy.
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
        if any(np.abs(one - walls[0]).max() > 1e-6 for one in walls[1:]):
            raise ValueError("bumps: expected the same probability of a bump for each angle")
        # In a file each share is rounded.
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
        """Number of angles that the robot may turn by at a bump."""
        return len(self.bumps)

    def leaving(self, event: int) -> "scipy.sparse.csr_array":
        """The probabilities of one event, row by row of where it begins.

        Event 0 is a step, `1 + i` a bump and the turn by angle `i`. With one angle events are
        observations.
        """
        return (self.moves, *self.bumps)[event]

    def after(self, event: int, weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
        """How probable it is to be in each cell after one event, as [`HiddenMap.leaving`][] counts.

        **Arguments:**

        - `event`: the event.
        - `weight`: how probable each cell is before it.

        **Returns:** probabilities whose sum is that of the event.
        """
        leaving, here = self.leaving(event), np.flatnonzero(weight > 0)
        if here.size < FEW * weight.size:
            leaving, weight = leaving[here], weight[here]
        return leaving.T @ weight

    def masses(self, weight: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "configurations"]:
        """What the cells of each configuration weigh together."""
        return np.bincount(self.configuration, weight, self.configurations)

    def by_position(
        self, weight: Float[np.ndarray, "cells"], positions: int
    ) -> Float[np.ndarray, "positions"]:
        """What the cells of each of the positions of a map weigh together, whatever the heading."""
        return np.bincount(self.configuration % positions, weight, positions)

    @functools.cached_property
    def bumping(self) -> Float[np.ndarray, "cells"]:
        """How probable it is that a robot bumps next, in each cell."""
        return np.asarray(self.bumps[0].sum(axis=1)).ravel()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to a file, which is replaced."""
        arrays = {"configuration": self.configuration, "start": _whole(self.start)}
        for name, matrix in zip(_names(self.angles), (self.moves, *self.bumps), strict=True):
            arrays |= {
                f"{name}_indptr": matrix.indptr.astype(np.int32),
                f"{name}_indices": matrix.indices.astype(np.int32),
                f"{name}_data": _whole(matrix.data),
            }
        header = {"format": _FORMAT, "version": _VERSION, "metadata": dict(self.metadata)}
        write_arrays(path, header, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "HiddenMap":
        """Read the file of a map.

        **Raises:** `ValueError` that names the file, if it is not one; `FileNotFoundError`.
        """
        sparse = import_module("scipy.sparse")
        header, arrays = read_arrays(path)
        if (header.get("format"), header.get("version")) != (_FORMAT, _VERSION):
            raise ValueError(
                f"{path}: expected a map for a belief, format {_FORMAT!r} version {_VERSION}, got "
                f"{header.get('format')!r} version {header.get('version')!r}"
            )
        metadata = Fields(header, f"{path}: ").get("metadata")
        try:
            start = arrays["start"] * _UNIT
            matrices = []
            angles = sum(name.endswith("_indptr") for name in arrays) - 1
            for name in _names(angles):
                data, indices, ends = (
                    arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr")
                )
                matrix = sparse.csr_array(
                    (data * _UNIT, indices, ends), shape=(start.size, start.size)
                )
                matrix.check_format()
                matrices.append(matrix)
            if not isinstance(metadata, dict):
                raise ValueError("metadata: expected an object")
            moves, *bumps = matrices
            return cls.of(moves, bumps, arrays["configuration"], start, metadata)
        except (KeyError, ValueError, TypeError) as error:
            raise ValueError(f"{path}: not a map for a belief, or altered: {error}") from None


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator knows: the configurations in which a robot may be."""

    cells: Int[np.ndarray, "configurations"]
    "The configurations, the likeliest first where that is known."
    probability: Float[np.ndarray, "configurations"]
    "How probable each is, if the robot is anywhere; all the same where that is not known."
    nowhere: float
    "How probable it is that the robot is nowhere on the map, 0 to 1."


def credible(mass: Float[np.ndarray, "configurations"], share: float, nowhere: float) -> Estimate:
    """The fewest configurations that are so probable together.

    **Arguments:**

    - `mass`: how probable each configuration is, to a factor.
    - `share`: the least probability of those of the answer together, of what all weigh.
    - `nowhere`: how probable it is that the robot is in none.

    **Returns:** [`Estimate`][], with no configurations if none weighs anything.

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
    # Rounding must not make a share of 1 hold all configurations there are.
    count = int(np.searchsorted(np.cumsum(mass), share * (1 - 1e-12))) + 1
    count = min(count, int(np.count_nonzero(mass)))
    return Estimate(order[:count].astype(np.int32), mass[:count], nowhere)


def _names(angles: int) -> list[str]:
    """What the matrices of a map are called in its file."""
    return ["moves", "bumps", *(f"bumps_{i}" for i in range(1, angles))]


def _whole(share: Float[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
    return np.asarray(np.rint(share / _UNIT), np.int32)
