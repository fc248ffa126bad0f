"""Batches of array rows, padded to a few lengths because JAX compiles a program for each length."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..base.precision import has_x64
from ..mapping.section import bucket


Part = TypeVar("Part")
Value = TypeVar("Value")


CHUNK = 1 << 18
"""Number of cells that are computed at once, to limit the memory needed besides the results."""
# Number of rows up to which a first stage is padded to a coarse size, to save a compilation.
_FEW = 1 << 12
# The last rows that a program of their own advances, and the stages after which it is worth it.
_LAST, _MANY = 64, 16


def slices(size: int) -> Iterator[slice]:
    """Yield slices of at most `CHUNK` entries that cover an array of `size` entries."""
    for first in range(0, size, CHUNK):
        yield slice(first, min(first + CHUNK, size))


def totals(
    label: Int[np.ndarray, "rows"], count: int, weight: np.ndarray | None = None
) -> Float[np.ndarray, "labels"]:
    """Count the rows with each of the labels 0 to `count - 1`, or sum the weights of these rows."""
    total = np.zeros(count)
    for part in slices(label.size):
        own = None if weight is None else weight[part]
        total += np.bincount(label[part] + 1, own, minlength=count + 1)[1:]
    return total


def with_last(rows: np.ndarray, size: int) -> np.ndarray:
    """Pad an array to `size` rows with copies of its last row."""
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)])


def padded(compute: Callable[..., Any], rows: Sequence[np.ndarray], size: int | None = None) -> Any:
    """Pad the arrays `rows` to `size`, apply a compiled function, and cut off the padding again."""
    count = len(rows[0])
    filled = (with_last(array, size or bucket(count)) for array in rows)
    return jax.tree.map(lambda array: np.asarray(array)[:count], compute(*filled))


def stacked(members: Sequence[Any], dtype: Any = None) -> Any:
    """Stack the parameters of several maps into one tree, whose arrays have an entry per map."""
    kind = jnp.zeros(()).dtype if dtype is None else dtype
    return jax.tree.map(lambda *leaves: np.stack(leaves).astype(kind), *members)


def params_of(params: Any, member: Any) -> Any:
    """Extract the parameters of map number `member` from a result of `stacked`."""
    return jax.tree.map(lambda leaf: leaf[member], params)


def in_stages(
    state: tuple[np.ndarray, ...], stage: Callable[[tuple[np.ndarray, ...], int], Any]
) -> tuple[np.ndarray, ...]:
    """Advance the rows of a batch in stages, and after each stage drop the rows that have ended.

    `stage(state, k)` advances the rows in stage `k`, where the state is a tuple of arrays over the
    rows, and returns the new state, a mask of the rows that have ended, and a tuple of arrays with
    their results. **Returns:** the results of all rows.
    """
    left, results = np.arange(len(state[0])), None
    for k in itertools.count():
        size = bucket(left.size) if k == 0 and left.size > _FEW else _coarse(left.size, k)
        after = stage(tuple(with_last(rows, size) for rows in state), k)
        state, ended, parts = jax.tree.map(lambda rows, n=left.size: np.asarray(rows)[:n], after)
        results = results or tuple(np.empty_like(rows) for rows in parts)
        for whole, rows in zip(results, parts, strict=True):
            whole[left[ended]] = rows[ended]
        left, state = left[~ended], tuple(rows[~ended] for rows in state)
        if not left.size:
            break
    return results or ()


def _coarse(rows: int, k: int) -> int:
    """Round a number of rows in stage `k` up to the next power of 4, at least 1,024, or to 64."""
    if rows <= _LAST and k >= _MANY:
        return _LAST
    return max(1 << 10, 4 ** math.ceil(math.log(rows, 4)))


def in_threads(compute: Callable[[Part], Value], parts: Iterable[Part]) -> Iterator[Value]:
    """Apply `compute` to `parts` on two threads, because XLA leaves cores idle between parts."""
    # A thread does not inherit the context that turns on 64-bit numbers.
    wide = has_x64()

    def compute_alike(part: Part) -> Value:
        with jax.enable_x64(wide):
            return compute(part)

    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(compute_alike, parts)
