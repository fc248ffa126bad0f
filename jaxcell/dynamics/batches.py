"""Batches of rows that are computed together, of few lengths, each of which is compiled once."""

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
Found = TypeVar("Found")


# Rows up to which a first stage has a few more rather than a program of its own.
_FEW = 1 << 12


def with_last(rows: np.ndarray, size: int) -> np.ndarray:
    """With more of the last row."""
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)])


def stacked(members: Sequence[Any], dtype: Any = None) -> Any:
    """The parameters of several members as one tree, whose arrays have an axis for the members."""
    kind = jnp.zeros(()).dtype if dtype is None else dtype
    return jax.tree.map(lambda *leaves: np.stack(leaves).astype(kind), *members)


def params_of(params: Any, member: Any) -> Any:
    """The parameters of one of several members."""
    return jax.tree.map(lambda leaf: leaf[member], params)


def in_stages(
    state: tuple[np.ndarray, ...], stage: Callable[[tuple[np.ndarray, ...], int], Any]
) -> tuple[np.ndarray, ...]:
    """Advance the rows of a batch by stages; those that have ended leave it.

    So nobody waits for the slowest.

    **Arguments:**

    - `state`: arrays over the rows.
    - `stage`: given the state and the number of the stage, gives the state after it, which rows
        have ended, and a tuple of arrays of what each row gives if it has.

    **Returns:** what each row gave.
    """
    left, found = np.arange(len(state[0])), None
    for k in itertools.count():
        size = bucket(left.size) if k == 0 and left.size > _FEW else _coarse(left.size)
        after = stage(tuple(with_last(rows, size) for rows in state), k)
        state, ended, given = jax.tree.map(lambda rows, n=left.size: np.asarray(rows)[:n], after)
        found = found or tuple(np.empty_like(rows) for rows in given)
        for whole, rows in zip(found, given, strict=True):
            whole[left[ended]] = rows[ended]
        left, state = left[~ended], tuple(rows[~ended] for rows in state)
        if not left.size:
            break
    return found or ()


def _coarse(rows: int) -> int:
    """The next of sizes that are a quarter of each other."""
    return max(1 << 10, 4 ** math.ceil(math.log(rows, 4)))


def in_threads(compute: Callable[[Part], Found], parts: Iterable[Part]) -> Iterator[Found]:
    """Compute parts on two threads, since XLA leaves cores idle between them."""
    with ThreadPoolExecutor(2) as pool:
        yield from pool.map(compute, parts)
