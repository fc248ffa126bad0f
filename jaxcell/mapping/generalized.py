import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.precision import require_x64


# Tolerance of the sum of a row.
_ROUNDING = 1e-12


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Chain:
    """A generalized cell mapping: every cell has several images with probabilities.

    It is a finite Markov chain (Hsu 1980; Alam 2018, Eq. 3.5). Row `b` of the arrays holds the
    `b`-th image of every cell and its probability. Unused entries of a cell with fewer images hold
    the cell itself and probability 0; they are not edges of the chain. If the probabilities of a
    cell sum to less than 1, the rest is the probability of leaving the space for a *sink*, from
    which nothing returns. Probabilities are never rescaled.

    Cell 0 stays or moves to cell 1, which stays; cell 2 leaves the space with probability 0.1:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> P = np.array([[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.9]])
        >>> chain = mapping.Chain.from_scipy(P)
        >>> chain.image.tolist()
        [[0, 1, 2], [1, 1, 2]]
        >>> chain.push(np.array([1.0, 0.0, 0.0])).tolist()
        [0.5, 0.5, 0.0]
        >>> chain.leaving.round(3).tolist()
        [0.0, 0.0, 0.1]
    """

    image: Int[Array, "branches cells"]
    probability: Float[Array, "branches cells"]
    half: "Chain | None" = None
    """For a chain that is estimated from samples, the chain from half of the samples; otherwise
    `None`. The results of both chains differ by about the sampling error."""

    def __init__(self, image: Any, probability: Any, half: "Chain | None" = None) -> None:
        """Copy and check two arrays of shape `[branches, cells]`.

        **Raises:** `ValueError` for arrays that are not a chain; their values are checked only
        outside `jit`. `RuntimeError` if JAX is set to 32 bits.
        """
        require_x64("a chain")
        _check_arrays(image, probability)
        object.__setattr__(self, "image", _kept(image, np.int32))
        object.__setattr__(self, "probability", _kept(probability, np.float64))
        object.__setattr__(self, "half", half)

    @classmethod
    def from_scipy(cls, matrix: Any) -> "Chain":
        """Create the chain of a transition matrix, sparse or dense.

        Row `i` has the probabilities of the images of cell `i`. The rest of a row, up to 1, is the
        probability of the sink.
        """
        rows = scipy.sparse.csr_array(matrix, copy=True)
        if rows.shape[0] != rows.shape[1]:
            raise ValueError(f"matrix: expected as many rows as columns, got {rows.shape}")
        return cls(*slots_of(rows))

    def to_scipy(self) -> scipy.sparse.csr_array:
        """Return the transition matrix without the sink; all its entries are positive.

        It is computed once, on the host, and stored with the chain, so its arrays are read-only.
        """
        return self._matrix

    @functools.cached_property
    def _matrix(self) -> scipy.sparse.csr_array:
        image, probability = np.asarray(self.image), np.asarray(self.probability)
        cells = image.shape[1]
        # Slots of probability 0, most slots of a sparse chain, are dropped before sorting.
        used = probability > 0
        at = np.flatnonzero(np.ascontiguousarray(used.T))
        # The search of scipy for components converts larger integers to this type each time.
        small = np.int32 if at.size < 2**31 else np.int64
        end = np.concatenate([[0], np.cumsum(used.sum(axis=0))]).astype(small)
        rows = (probability.T.ravel()[at], image.T.ravel()[at].astype(small, copy=False), end)
        matrix = scipy.sparse.csr_array(rows, shape=(cells, cells))
        matrix.sum_duplicates()
        for part in (matrix.data, matrix.indices, matrix.indptr):
            part.flags.writeable = False
        return matrix

    @functools.cached_property
    def can_leave(self) -> Bool[np.ndarray, "cells"]:
        """A mask of the cells whose next step may go to the sink, as a NumPy array."""
        return leaving_rows(self._matrix) > 0

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.image.shape[-1]

    @property
    @jax.jit
    def leaving(self) -> Float[Array, "cells"]:
        """The probability that the next step from each cell goes to the sink."""
        missing = 1 - jnp.sum(self.probability, axis=0)
        return jnp.where(missing > _ROUNDING, missing, 0.0)

    @jax.jit
    def push(self, distribution: Float[Array, "cells"]) -> Float[Array, "cells"]:
        """Compute the distribution one step later, `p P`; its missing mass is in the sink."""

        def add(later, branch):  # type: ignore[no-untyped-def]
            image, probability = branch
            return later.at[image].add(probability * distribution), None

        later, _ = jax.lax.scan(add, jnp.zeros_like(distribution), (self.image, self.probability))
        return later

    @jax.jit
    def pull(self, value: Float[Array, "cells"]) -> Float[Array, "cells"]:
        """Compute the expected value one step later, `P v`; the value of the sink is 0."""

        def add(expected, branch):  # type: ignore[no-untyped-def]
            image, probability = branch
            return expected + probability * value[image], None

        # Eight branches are unrolled to save memory traffic of the sums.
        branches = (self.image, self.probability)
        return jax.lax.scan(add, jnp.zeros_like(value), branches, unroll=8)[0]

    def tree_flatten_with_keys(self):  # type: ignore[no-untyped-def]
        fields = ("image", "probability", "half")
        return [(jax.tree_util.GetAttrKey(f), getattr(self, f)) for f in fields], None

    @classmethod
    def tree_unflatten(cls, _, fields):  # type: ignore[no-untyped-def]
        # The constructor is bypassed: JAX passes objects other than arrays, and the results of a
        # transformation were checked on entry.
        chain = object.__new__(cls)
        for name, field in zip(("image", "probability", "half"), (*fields, None), strict=False):
            object.__setattr__(chain, name, field)
        return chain


def _kept(array: Any, kind: Any) -> Any:
    """Convert an array to a JAX array that shares no memory with a NumPy array."""
    if isinstance(array, jax.Array):
        return array.astype(kind)
    return jax.device_put(np.array(array, kind))


def slots_of(
    rows: scipy.sparse.csr_array,
) -> tuple[Int[np.ndarray, "branches cells"], Float[np.ndarray, "branches cells"]]:
    """Convert a transition matrix to the images of each cell and their probabilities.

    Duplicate entries of the matrix are summed in place, and zeros are removed.
    """
    rows.sum_duplicates()
    rows.eliminate_zeros()
    cells = rows.shape[0]
    edges = np.diff(rows.indptr)
    branches = max(1, int(edges.max(initial=0)))
    cell = np.repeat(np.arange(cells), edges)
    slot = np.arange(rows.nnz) - np.repeat(rows.indptr[:-1], edges)
    image = np.tile(np.arange(cells, dtype=np.int32), (branches, 1))
    image[slot, cell] = rows.indices
    probability = np.zeros((branches, cells), np.result_type(rows.dtype, np.float32))
    probability[slot, cell] = rows.data
    return image, probability


def leaving_rows(matrix: scipy.sparse.csr_array) -> Float[np.ndarray, "cells"]:
    """Compute [`Chain.leaving`][] from the transition matrix."""
    missing = 1 - matrix @ np.ones(matrix.shape[1])
    return np.where(missing > _ROUNDING, missing, 0.0)


def _check_arrays(image: Any, probability: Any) -> None:
    shape, dtype = np.shape(image), jnp.result_type(probability)
    if len(shape) != 2 or 0 in shape or np.shape(probability) != shape:
        raise ValueError(
            "image, probability: expected two arrays of one shape [branches, cells], got "
            f"{list(shape)} and {list(np.shape(probability))}"
        )
    if not jnp.issubdtype(jnp.result_type(image), jnp.integer):
        raise ValueError(f"image: expected whole numbers, got {jnp.result_type(image)}")
    if dtype != jnp.float64:
        raise ValueError(f"probability: expected float64, got {dtype}")
    if isinstance(image, jax.core.Tracer) or isinstance(probability, jax.core.Tracer):
        return
    image, probability = np.asarray(image), np.asarray(probability)
    cells = shape[1]
    if image.min() < 0 or image.max() >= cells:
        branch, cell = np.argwhere((image < 0) | (image >= cells))[0]
        raise ValueError(
            f"image[{branch}, {cell}] is {image[branch, cell]}; cells are 0 to {cells - 1}"
        )
    # A sum is finite and a minimum is not negative only if that holds for all probabilities.
    total = probability.sum(axis=0)
    if not (probability.min() >= 0):
        branch, cell = np.argwhere(~(probability >= 0))[0]
        raise ValueError(
            f"probability[{branch}, {cell}] is {probability[branch, cell]}; expected 0 to 1"
        )
    if not (total.max() <= 1 + _ROUNDING):
        cell = int(np.argmax(total))
        raise ValueError(
            f"probability: the numbers of cell {cell} sum to {total[cell]!r}; expected at most 1"
        )
