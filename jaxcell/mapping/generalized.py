import dataclasses
import functools
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base import memory
from ..base.divided import of_members
from ..base.doubts import warn
from ..base.indices import as_array, check_indices, check_whole
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced, widened


# Tolerance of the sum of a row, and for numbers of 32 bits.
_ROUNDING, _ROUNDING_32 = 1e-12, 1e-6
_OF_GRAPH = "; networkx.to_scipy_sparse_array(graph) makes one of a graph"
# Peak memory of the construction of a chain, per branch and cell.
BYTES_PER_SLOT = 26
# Sums of multiples of 1 / _COARSE are exact, so that 1 minus a sum has all its digits.
_COARSE = 2.0**40


@widened
@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Chain(Pictured):
    """A generalized cell mapping: every cell has several images with probabilities.

    It is a finite Markov chain (Hsu 1980; Alam 2018, Eq. 3.5). Row `b` of the arrays holds the
    `b`-th image of every cell and its probability. Unused entries of a cell with fewer images hold
    the cell itself and probability 0; they are not edges of the chain. If the probabilities of a
    cell sum to less than 1, the rest is the probability of leaving the space for a *sink*, from
    which nothing returns; a rest of at most 1e-12 counts as rounding. Numbers of 32 bits whose sum
    differs from 1 as rounding to 32 bits explains, by at most 1e-6, are divided by it. Others are
    never rescaled, but a warning says if sums below 1 look like those of rounded numbers.

    The arrays have as many rows as the cell with the most images needs, and 12 bytes per entry.

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
    """For a chain of a map, a coarser chain on the same cells, with half of the samples or of the
    data; otherwise `None`. The difference between the results of both estimates the error."""

    def __init__(self, image: Any, probability: Any, half: "Chain | None" = None) -> None:
        """Copy and check two arrays of shape `[branches, cells]`.

        **Raises:** `ValueError` for arrays that are not a chain; if JAX traces the call, the
        probabilities are NaN instead. `RuntimeError` if JAX traces the call with 32 bits.
        """
        require_x64("a chain")
        image, probability = as_array(image, "image"), as_array(probability, "probability")
        probability = _in_64_bits(probability)
        check_arrays(image, probability, ("branches", "cells"))
        image, probability = _kept(image, np.int32), _kept(probability, np.float64)
        if traced(image, probability):
            probability = jnp.where(are_chains(image, probability), probability, jnp.nan)
        object.__setattr__(self, "image", image)
        object.__setattr__(self, "probability", probability)
        object.__setattr__(self, "half", half)

    @classmethod
    def from_scipy(cls, matrix: Any) -> "Chain":
        """Create the chain of a transition matrix, sparse or dense.

        Row `i` has the probabilities of the images of cell `i`. The rest of a row, up to 1, is the
        probability of the sink. A dense matrix may be traced by `jit`, `vmap` and `grad`; then each
        cell has all cells as images. The columns of a DataFrame of pandas are those of its labels.
        """
        if hasattr(matrix, "iloc"):
            matrix = _by_label(matrix)
        if not scipy.sparse.issparse(matrix):
            matrix = as_array(matrix, "matrix", _OF_GRAPH)
        shape, kind = matrix.shape, matrix.dtype
        if len(shape) != 2 or shape[0] != shape[1] or not shape[0]:
            raise ValueError(f"matrix: expected as many rows as columns, got {shape}")
        if kind.itemsize > 8 or kind == np.float16:
            raise ValueError(f"matrix: expected float64, got {kind}; convert it with astype(float)")
        if traced(matrix):
            return cls(np.tile(np.arange(shape[0])[:, None], (1, shape[0])), matrix.T)
        rows = scipy.sparse.csr_array(matrix, copy=True)
        # The arrays are new, so JAX need not copy them.
        return cls(*jax.device_put(slots_of(rows)))

    @classmethod
    def of_input(cls, value: Any) -> "Chain | None":
        """Create a chain of a matrix, or of a networkx graph whose weights are probabilities.

        Cells have the names of the nodes if these are 0, 1, ..., and otherwise their order.
        """
        if hasattr(value, "is_multigraph"):
            value = _weights(value)
        matrix = hasattr(value, "shape") or isinstance(value, list)
        return cls.from_scipy(value) if matrix else None

    def to_scipy(self) -> scipy.sparse.csr_array:
        """Return the transition matrix without the sink; all its entries are positive.

        It is computed once, on the host, and stored with the chain, so its arrays are read-only.
        """
        return self._matrix

    @functools.cached_property
    def _matrix(self) -> scipy.sparse.csr_array:
        return matrix_of(np.asarray(self.image), np.asarray(self.probability))

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
        return jnp.where(self._missing > _ROUNDING, self._missing, 0.0)

    @property
    def rounding(self) -> Float[Array, "cells"]:
        """By how much the probabilities of each cell and `leaving` fail to sum to 1."""
        return jnp.where(self._missing > _ROUNDING, 0.0, self._missing)

    @property
    def _missing(self) -> Float[Array, "cells"]:
        coarse = jnp.floor(self.probability * _COARSE) / _COARSE
        return 1 - jnp.sum(coarse, axis=0) - jnp.sum(self.probability - coarse, axis=0)

    def push(self, distribution: npt.ArrayLike, steps: int = 1) -> Float[Array, "cells"]:
        """Compute the distribution after steps, `p P^steps`; its missing mass is in the sink."""
        require_x64("Chain.push")
        later = jnp.asarray(number_per_cell(distribution, self.cells, "distribution"))
        for _ in range(check_whole("steps", steps, 0)):
            later = self._push(later)
        return later

    @jax.jit
    def _push(self, distribution: Float[Array, "cells"]) -> Float[Array, "cells"]:
        def add(later, branch):  # type: ignore[no-untyped-def]
            image, probability = branch
            return later.at[image].add(probability * distribution), None

        start = jnp.zeros_like(distribution * self.probability[0])
        later, _ = jax.lax.scan(add, start, (self.image, self.probability))
        # For the derivative, which looks up numbers.
        return of_members(later, self.image)

    def pull(self, value: npt.ArrayLike) -> Float[Array, "cells"]:
        """Compute the expected value one step later, `P v`; the value of the sink is 0."""
        require_x64("Chain.pull")
        return self._pull(number_per_cell(value, self.cells, "value"))

    @jax.jit
    def _pull(self, value: Float[Array, "cells"]) -> Float[Array, "cells"]:
        def add(expected, branch):  # type: ignore[no-untyped-def]
            image, probability = branch
            return expected + probability * value[image], None

        # Eight branches are unrolled to save memory traffic of the sums.
        branches = (self.image, self.probability)
        value = of_members(value, self.image)
        start = jnp.zeros_like(value * self.probability[0])
        return jax.lax.scan(add, start, branches, unroll=8)[0]

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


if TYPE_CHECKING:
    # SciPy and networkx have no types.
    ChainLike: TypeAlias = Chain | Any
    """A chain, or what public functions convert to one: a square transition matrix of NumPy, JAX,
    SciPy, pandas or lists, or a graph of networkx whose weights are probabilities."""
else:
    ChainLike = Chain


def _by_label(frame: Any) -> Any:
    """Return the matrix of a DataFrame, with its columns in the order of its index."""
    rows, columns = frame.index, frame.columns
    if not (rows.is_unique and columns.is_unique and set(rows) == set(columns)):
        raise ValueError(
            f"matrix: the columns {list(columns[:8])} of the DataFrame are not the labels "
            f"{list(rows[:8])} of its index, each once; P.to_numpy() is taken by position"
        )
    return frame[rows].to_numpy()


def _weights(network: Any) -> scipy.sparse.csr_array:
    """Return the weights of the edges of a networkx graph as a transition matrix."""
    import networkx

    nodes = range(len(network)) if set(network) == set(range(len(network))) else list(network)
    if not nodes:
        raise ValueError("chain: expected a graph with vertices, got one without")
    matrix = networkx.to_scipy_sparse_array(network, nodes)
    beyond = matrix.sum(axis=1).max() > 1 + _ROUNDING_32
    for tail, head, about in network.edges(data=True):
        if beyond and "weight" not in about:
            has = f", but {', '.join(map(str, about))}" if about else ""
            raise ValueError(
                f"chain: the edge {tail!r}, {head!r} has no attribute `weight`{has}; expected its "
                "probability there; patrol.random_walk(graph) makes a chain of any graph"
            )
    return matrix


def number_per_cell(values: Any, cells: int, name: str) -> Any:
    """Return floating-point numbers as an array, after checking that there is one per cell."""
    array = as_array(values, name)
    if array.shape != (cells,):
        raise ValueError(
            f"{name}: expected a number for each of {cells} cells, got {list(array.shape)}"
        )
    return array if jnp.issubdtype(array.dtype, jnp.inexact) else array.astype(np.float64)


def _in_64_bits(probability: Any) -> Any:
    """Convert probabilities to 64 bits; divide those of a cell by their sum if 32 bits rounded it.

    Numbers of 64 bits may have been rounded to 32 bits before.
    """
    known = not traced(probability) and probability.dtype in (bool, np.float32, np.float64)
    if not known or probability.ndim != 2:
        return probability
    numbers = np.asarray(probability, np.float64)
    wrong = np.abs(1 - numbers.sum(axis=0))
    (cells,) = np.nonzero((wrong > _ROUNDING) & (wrong <= _ROUNDING_32))
    exact = numbers[:, cells] == numbers[:, cells].astype(np.float32)
    few = wrong[cells] <= np.count_nonzero(numbers[:, cells], axis=0) * 2.0**-24
    cells = cells[exact.all(axis=0) & few]
    if not cells.size:
        return probability if probability.dtype == np.float64 else numbers
    total = np.ones(numbers.shape[1])
    total[cells] = numbers[:, cells].sum(axis=0)
    return numbers / total


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
    hub = int(edges.argmax()) if cells else 0
    memory.check(
        cells * branches * BYTES_PER_SLOT,
        f"a chain of {cells} cells with room for the {branches} images of cell {hub} in each",
        f"the mean is {rows.nnz / max(1, cells):.1f} images: let cell {hub} reach its images by "
        "way of a tree of additional cells, whose steps count too",
    )
    cell = np.repeat(np.arange(cells), edges)
    slot = np.arange(rows.nnz) - np.repeat(rows.indptr[:-1], edges)
    image = np.tile(np.arange(cells, dtype=np.int32), (branches, 1))
    image[slot, cell] = rows.indices
    whole = rows.dtype.kind in "biu"
    probability = np.zeros((branches, cells), np.float64 if whole else rows.dtype)
    probability[slot, cell] = rows.data
    return image, probability


def matrix_of(
    image: Int[np.ndarray, "branches cells"], probability: Float[np.ndarray, "branches cells"]
) -> scipy.sparse.csr_array:
    """Compute [`Chain.to_scipy`][] from the arrays of a chain."""
    cells = image.shape[1]
    # Slots of probability 0, most slots of a sparse chain, are dropped before sorting.
    used = probability > 0
    cell, branch = np.divmod(np.flatnonzero(np.ascontiguousarray(used.T)), probability.shape[0])
    # The search of scipy for components converts larger integers to this type each time.
    small = np.int32 if cell.size < 2**31 else np.int64
    end = np.concatenate([[0], np.cumsum(used.sum(axis=0))]).astype(small)
    rows = (probability[branch, cell], image[branch, cell].astype(small, copy=False), end)
    matrix = scipy.sparse.csr_array(rows, shape=(cells, cells))
    matrix.sum_duplicates()
    for part in (matrix.data, matrix.indices, matrix.indptr):
        part.flags.writeable = False
    return matrix


def leaving_slots(
    probability: Float[np.ndarray, "*chains branches cells"],
) -> Float[np.ndarray, "*chains cells"]:
    """Compute [`Chain.leaving`][] from the probabilities of one or several chains."""
    missing = 1 - probability.sum(axis=-2)
    if (missing > _ROUNDING / 2).any():
        coarse = np.floor(probability * _COARSE) / _COARSE
        missing = 1 - coarse.sum(axis=-2) - (probability - coarse).sum(axis=-2)
    return np.where(missing > _ROUNDING, missing, 0.0)


def leaving_rows(matrix: scipy.sparse.csr_array) -> Float[np.ndarray, "cells"]:
    """Compute [`Chain.leaving`][] from the transition matrix."""
    missing = missing_rows(matrix)
    return np.where(missing > _ROUNDING, missing, 0.0)


def are_chains(
    image: Int[np.ndarray | Array, "*#members branches cells"],
    probability: Float[np.ndarray | Array, "*#members branches cells"],
) -> Any:
    """Check the arrays of the chain of each member as [`Chain`][] does; return `[*members]`."""
    slots = (-2, -1)
    exist = (image.min(axis=slots) >= 0) & (image.max(axis=slots) < image.shape[-1])
    most = probability.sum(axis=-2).max(axis=-1)
    return exist & (probability.min(axis=slots) >= 0) & (most <= 1 + _ROUNDING)


def missing_rows(matrix: scipy.sparse.csr_array) -> Float[np.ndarray, "cells"]:
    """Compute 1 minus the sum of each row, with all digits."""
    coarse = np.floor(matrix.data * _COARSE) / _COARSE
    missing = np.ones(matrix.shape[0])
    for part in (coarse, matrix.data - coarse):
        rows = scipy.sparse.csr_array((part, matrix.indices, matrix.indptr), matrix.shape)
        missing = missing - rows @ np.ones(matrix.shape[1])
    return missing


def check_arrays(image: Any, probability: Any, axes: tuple[str, ...]) -> None:
    """Check the arrays of a chain or of a sequence of chains, whose axes have these names."""
    shape, dtype = np.shape(image), jnp.result_type(probability)
    if len(shape) != len(axes) or 0 in shape or np.shape(probability) != shape:
        raise ValueError(
            f"image, probability: expected two arrays of one shape [{', '.join(axes)}], got "
            f"{list(shape)} and {list(np.shape(probability))}"
        )
    if dtype != jnp.float64:
        raise ValueError(
            f"probability: expected float64, got {dtype}; convert it with astype(float), and "
            "divide the numbers of each cell by their sum, which rounding has changed"
        )
    check_indices(image, shape[-1], "image")
    if isinstance(image, jax.core.Tracer) or isinstance(probability, jax.core.Tracer):
        return
    probability = np.asarray(probability)
    # A sum is finite and a minimum is not negative only if that holds for all probabilities.
    total = probability.sum(axis=-2)
    if not (probability.min() >= 0):
        place = tuple(np.argwhere(~(probability >= 0))[0].tolist())
        raise ValueError(f"probability{list(place)} is {probability[place]}; expected 0 to 1")
    if not (total.max() <= 1 + _ROUNDING):
        cell, most = int(np.argmax(total)) % shape[-1], float(total.max())
        raise ValueError(
            f"probability: the numbers of cell {cell} sum to {most!r}; expected at most 1; if they "
            "are rounded, divide numpy.asarray(P, float) by the sum of each row"
        )
    if total.ndim == 1 and (rounded := _rounded(probability, total)).size:
        warn(
            f"probability: the numbers of {rounded.size} of {total.size} cells sum to a little "
            f"less than 1 (those of cell {rounded[0]} to {total[rounded[0]]:.12g}), as rounded "
            "numbers do; the rest counts as the probability of leaving the space; if it is "
            "rounding, divide the numbers of each cell by their sum",
        )


def _rounded(
    probability: Float[np.ndarray, "branches cells"], total: Float[np.ndarray, "cells"]
) -> Int[np.ndarray, "rounded"]:
    """Find cells whose sum is below 1 as if their numbers had 3 to 11 decimals, or 32 bits."""
    (short,) = np.nonzero(total < 1 - _ROUNDING)
    numbers, missing = probability[:, short], 1 - total[short]
    images = np.count_nonzero(numbers, axis=0)
    rounded = missing <= images * 2.0**-25
    rounded &= (numbers == numbers.astype(np.float32)).all(axis=0)
    for decimals in range(3, 12):
        few = (numbers == numbers.round(decimals)).all(axis=0)
        rounded |= few & (missing <= images * (0.5 * 10.0**-decimals) + _ROUNDING)
    return short[rounded]
