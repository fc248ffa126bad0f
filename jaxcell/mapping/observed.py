import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from .generalized import Chain


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ObservedChain:
    """A generalized map with the observation of the bump sensor at each step.

    It extends [`Chain`][] as [`jaxcell.mapping.SimpleMap`][] extends an image: a hidden Markov
    model whose observations belong to steps.

    Of two cells, the first moves on, or bumps and stays; the second stays:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> moves = np.array([[0.0, 0.7], [0.0, 1.0]])
        >>> model = mapping.ObservedChain.from_scipy(moves, np.array([[0.3, 0.0], [0.0, 0.0]]))
        >>> model.chain.image.tolist(), model.bumped.tolist()
        ([[1, 1], [0, 1]], [[False, False], [True, False]])
    """

    chain: Chain
    bumped: Bool[Array, "branches cells"]
    "A mask of the steps with a bump, observation 1."

    @classmethod
    def from_scipy(cls, moves: Any, bumps: Any) -> "ObservedChain":
        """Make the model from the probabilities of steps with either observation.

        **Arguments:**

        - `moves`, `bumps`: square arrays, sparse or dense; row `i` holds the probabilities of
            leaving cell `i` with observation 0 and with observation 1.

        **Raises:** as [`Chain`][].
        """
        both = scipy.sparse.hstack([scipy.sparse.csr_array(m) for m in (moves, bumps)], "csr")
        cells = both.shape[0]
        count = np.diff(both.indptr)
        cell = np.repeat(np.arange(cells), count)
        slot = np.arange(both.nnz) - np.repeat(both.indptr[:-1], count)
        shape = (max(1, int(count.max(initial=0))), cells)
        image = np.broadcast_to(np.arange(cells, dtype=np.int32), shape).copy()
        probability, bumped = np.zeros(shape), np.zeros(shape, bool)
        image[slot, cell] = both.indices % cells
        probability[slot, cell] = both.data
        bumped[slot, cell] = both.indices >= cells
        return cls(Chain(image, probability), jnp.asarray(bumped))

    def to_scipy(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """Return the probabilities of steps with observation 0, and with observation 1."""
        bumped, probability = np.asarray(self.bumped), np.asarray(self.chain.probability)
        parts = [np.where(bumped == bit, probability, 0) for bit in (False, True)]
        moves, bumps = (Chain(self.chain.image, part).to_scipy() for part in parts)
        return moves, bumps

    def step(
        self, distribution: Float[Array, "cells"], observation: Int[Array, ""] | int
    ) -> Float[Array, "cells"]:
        """Compute the mass in each cell after a step with an observation; works under `jit`.

        Relative to the sum of the distribution, its sum is the probability of the observation.
        """
        kept = jnp.where(self.bumped == (observation == 1), self.chain.probability, 0)
        return _with(self.chain, kept).push(distribution)

    def back(
        self, value: Float[Array, "cells"], observation: Int[Array, ""] | int
    ) -> Float[Array, "cells"]:
        """Compute the expected value one step later, over the steps with an observation."""
        kept = jnp.where(self.bumped == (observation == 1), self.chain.probability, 0)
        return _with(self.chain, kept).pull(value)


def _with(chain: Chain, probability: Float[Array, "branches cells"]) -> Chain:
    """Replace the probabilities of a chain by a part of them, unchecked."""
    return Chain.tree_unflatten(None, (chain.image, probability))
