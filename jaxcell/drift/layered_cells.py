import dataclasses
import functools
from collections.abc import Sequence

import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Bool, Int

from ..base.shown import Shown
from ..mapping import Chain, ChainSequence
from ..mapping.sequence import as_sequence
from .water import Water


@dataclasses.dataclass(frozen=True, eq=False)
class Sea(Shown):
    """The cells of several layers of the sea, numbered layer after layer, the surface first.

    A drifter drifts within its layer, and may move to the cell directly above or below (Alam 2018,
    section 5.3.2).

    Two layers of three cells; the water of the surface flows East, and the water below it West:

        >>> import numpy as np
        >>> from jaxcell import drift, examples, mapping
        >>> layers = [examples.water([[1, 1, 1]], depth) for depth in (0.0, 5.0)]
        >>> east, west = ([1, 2, 2], [0, 0, 1])
        >>> chains = [mapping.Chain(np.int32([to]), np.ones((1, 3))) for to in (east, west)]
        >>> sea = drift.Sea.of(layers, chains)
        >>> sea.cells, sea.layer.tolist(), sea.below.tolist(), sea.drift.image.tolist()
        (6, [0, 0, 0, 1, 1, 1], [3, 4, 5, -1, -1, -1], [[1, 2, 2, 3, 3, 4]])
    """

    drift: Chain
    """The map of the drift within layers. In a periodic current its states are the cells at each
    phase, phase after phase."""
    layer: Int[np.ndarray, "cells"]
    "The layer of each cell, 0 at the surface."
    above: Int[np.ndarray, "cells"]
    "The cell directly above, or -1."
    below: Int[np.ndarray, "cells"]
    "The cell directly below, or -1 at the sea bed and in the last layer."
    number: Int[np.ndarray, "layers rows columns"]
    "The number of the cell in each square of each layer; -1 where there is no water."
    phases: int = 1
    "Number of phases of the current."

    @classmethod
    def of(cls, waters: Sequence[Water], chains: Sequence[Chain | ChainSequence]) -> "Sea":
        """Combine the cells and the drift maps of layers.

        **Arguments:**

        - `waters`: the water cells of each layer, the surface first, on one grid.
        - `chains`: the chain of each layer over its cells, from [`jaxcell.drift.drift_map`][],
            or sequences with the same number of phases, from [`jaxcell.drift.drift_maps`][].
        """
        if not waters or len(chains) != len(waters):
            raise ValueError(
                f"chains: expected one for each layer, got {len(chains)} for {len(waters)} layers"
            )
        shape = waters[0].number.shape
        for k, (water, chain) in enumerate(zip(waters, chains, strict=True)):
            if water.number.shape != shape:
                raise ValueError(
                    f"waters: layer {k} has {water.number.shape} rows and columns, and layer 0 "
                    f"has {shape}"
                )
            if water.wraps != waters[0].wraps:
                raise ValueError(f"waters: layers 0 and {k}: only one of them goes round the Earth")
            if chain.cells != water.cells:
                raise ValueError(
                    f"chains: that of layer {k} has {chain.cells} cells, and its water has "
                    f"{water.cells}"
                )
        tides = [*map(as_sequence, chains)]
        phases = {tide.phases for tide in tides}
        if len(phases) > 1:
            raise ValueError(f"chains: expected as many phases in each layer, got {sorted(phases)}")
        sizes = [water.cells for water in waters]
        first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        dry = np.full((1, *shape), -1)
        place = [
            np.where(water.number >= 0, water.number + start, -1)
            for water, start in zip(waters, first, strict=True)
        ]
        number = np.concatenate([dry, place, dry])
        layer = np.repeat(np.arange(len(waters)), sizes)
        row = np.concatenate([water.row for water in waters])
        column = np.concatenate([water.column for water in waters])
        return cls(
            _side_by_side(tides).unrolled,
            layer.astype(np.int32),
            number[layer, row, column].astype(np.int32),
            number[layer + 2, row, column].astype(np.int32),
            number[1:-1].astype(np.int32),
            *phases,
        )

    @property
    def cells(self) -> int:
        """Number of cells in all layers."""
        return self.layer.size

    @functools.cached_property
    def entries(self) -> scipy.sparse.coo_array:
        """The entries of the transition matrix of the drift."""
        return self.drift.to_scipy().tocoo()

    @functools.cached_property
    def squares(
        self,
    ) -> tuple[Int[np.ndarray, "cells"], Int[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
        """The layer, row and column of every cell."""
        layer, row, column = np.nonzero(self.number >= 0)
        return layer, row, column

    def on_squares(self, values: npt.ArrayLike, fill: float | int = np.nan) -> np.ndarray:
        """Arrange values of all cells on grids of the layers; squares without water get `fill`."""
        values = np.asarray(values)
        grid = np.full(self.number.shape, fill, np.result_type(values, fill))
        grid[self.squares] = values
        return grid

    @property
    def ascent(self) -> scipy.sparse.csr_array:
        """The transition matrix of going up; the row of a cell with no cell above is 0."""
        return self._steps(self.above)

    @property
    def descent(self) -> scipy.sparse.csr_array:
        """The transition matrix of going down; the row of a cell with no cell below is 0."""
        return self._steps(self.below)

    def _steps(self, to: Int[np.ndarray, "cells"]) -> scipy.sparse.csr_array:
        now = np.arange(self.phases)[:, None]
        cell, later = np.flatnonzero(to >= 0), (now + 1) % self.phases
        tail, head = (now * to.size + cell).ravel(), (later * to.size + to[cell]).ravel()
        return scipy.sparse.csr_array(
            (np.ones(tail.size), (tail, head)), shape=2 * (self.drift.cells,)
        )

    def at_any_phase(self, mask: Bool[np.ndarray, "states"]) -> Bool[np.ndarray, "cells"]:
        """Mark the cells where `mask`, with an entry per phase and cell, is true at any phase."""
        return np.any(mask.reshape(self.phases, self.cells), axis=0)


def _side_by_side(tides: Sequence[ChainSequence]) -> ChainSequence:
    """Combine sequences of chains over different cells into one sequence."""
    branches = max(tide.image.shape[1] for tide in tides)
    images, probabilities, start = [], [], 0
    for tide in tides:
        image = np.tile(np.arange(tide.cells, dtype=np.int32), (tide.phases, branches, 1))
        probability = np.zeros(image.shape)
        used = tide.image.shape[1]
        image[:, :used], probability[:, :used] = tide.image, tide.probability
        images.append(image + start)
        probabilities.append(probability)
        start += tide.cells
    arrays = (np.concatenate(layers, axis=2) for layers in (images, probabilities))
    return ChainSequence(*map(jax.device_put, arrays))
