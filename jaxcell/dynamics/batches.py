"""Batches of rows, padded to a few lengths, because JAX compiles a program for each length."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ..mapping.section import bucket


Part = TypeVar("Part")
Value = TypeVar("Value")


CHUNK = 1 << 18
"""Number of cells that are computed at once. It limits the memory that is needed in addition to the
result."""
# Number of rows up to which a first stage is padded to a coarse size, to save a compilation.
_FEW = 1 << 12


def slices(size: int) -> Iterator[slice]:
    """Yield the chunks of an array over cells."""
    for first in range(0, size, CHUNK):
        yield slice(first, min(first + CHUNK, size))


def with_last(rows: np.ndarray, size: int) -> np.ndarray:
    """Pad an array to `size` rows with copies of its last row."""
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)])


def padded(compute: Callable[..., Any], rows: Sequence[np.ndarray], size: int | None = None) -> Any:
    """Apply a compiled function to padded arrays, and return its results without the padding."""
    count = len(rows[0])
    filled = (with_last(array, size or bucket(count)) for array in rows)
    return jax.tree.map(lambda array: np.asarray(array)[:count], compute(*filled))


def stacked(members: Sequence[Any], dtype: Any = None) -> Any:
    """Stack the parameters of several members into one tree of arrays over the members."""
    kind = jnp.zeros(()).dtype if dtype is None else dtype
    return jax.tree.map(lambda *leaves: np.stack(leaves).astype(kind), *members)


def params_of(params: Any, member: Any) -> Any:
    """Extract the parameters of one member from stacked parameters."""
    return jax.tree.map(lambda leaf: leaf[member], params)


def in_stages(
    state: tuple[np.ndarray, ...], stage: Callable[[tuple[np.ndarray, ...], int], Any]
) -> tuple[np.ndarray, ...]:
    """Advance the rows of a batch stage by stage, and drop the rows that have ended.

    `stage` is a function of the state, a tuple of arrays over the rows, and of the number of the
    stage. It returns the new state, a mask of the rows that have ended, and a tuple of arrays with
    their results. Returns the results of all rows.
    """
    left, results = np.arange(len(state[0])), None
    for k in itertools.count():
        size = bucket(left.size) if k == 0 and left.size > _FEW else _coarse(left.size)
        after = stage(tuple(with_last(rows, size) for rows in state), k)
        state, ended, parts = jax.tree.map(lambda rows, n=left.size: np.asarray(rows)[:n], after)
        results = results or tuple(np.empty_like(rows) for rows in parts)
        for whole, rows in zip(results, parts, strict=True):
            whole[left[ended]] = rows[ended]
        left, state = left[~ended], tuple(rows[~ended] for rows in state)
        if not left.size:
            break
    return results or ()


def _coarse(rows: int) -> int:
    """Round a number of rows up to the next power of 4, at least 1,024."""
    return max(1 << 10, 4 ** math.ceil(math.log(rows, 4)))


def in_threads(compute: Callable[[Part], Value], parts: Iterable[Part]) -> Iterator[Value]:
    """Compute `parts` on two threads, because XLA leaves cores idle between two parts."""
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(compute, parts)
