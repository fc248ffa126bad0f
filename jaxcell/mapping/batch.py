"""Batches of chains on the host: what depends on the possible steps only is computed once."""

import dataclasses
import functools
import math
from collections.abc import Iterator

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from .generalized import leaving_slots


# Largest number of probabilities that are computed at once.
_PART = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False)
class Sums:
    """Sums of the rows of an array that have the same number."""

    number: Int[np.ndarray, "sums"]
    "The numbers, in ascending order."
    matrix: scipy.sparse.csr_array
    "The matrix that sums the rows."

    @classmethod
    def of(cls, numbers: Int[np.ndarray, "rows"]) -> "Sums":
        order = np.argsort(numbers, kind="stable")
        ranked = numbers[order]
        (begin,) = np.nonzero(np.diff(ranked, prepend=-1))
        number, rows = ranked[begin], (np.ones(order.size), order, np.append(begin, order.size))
        return cls(number, scipy.sparse.csr_array(rows, shape=(number.size, order.size)))

    def add(
        self, total: Float[np.ndarray, "numbers members"], rows: Float[np.ndarray, "rows members"]
    ) -> None:
        """Add each row to the row of `total` with its number."""
        total[self.number] += self.matrix @ rows


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Chains with the same possible steps."""

    cells: int
    tail: Int[np.ndarray, "steps"]
    head: Int[np.ndarray, "steps"]
    "The cell to which a step leads, or `cells` for a step to the sink."
    chance: Float[np.ndarray, "steps #members"]
    "The probability of each step; one column if all chains are the same."

    @classmethod
    def of(
        cls,
        image: Int[np.ndarray, "branches cells"],
        probability: Float[np.ndarray, "members branches cells"],
    ) -> "Batch":
        """Create a batch of chains with the same images and the same possible steps."""
        used = probability[0] > 0
        leaving = leaving_slots(probability)
        (last,) = np.nonzero(leaving[0])
        tail = np.append(np.nonzero(used)[1], last)
        head = np.append(image[used].astype(np.int64), np.full(last.size, image.shape[1]))
        chance = np.concatenate([probability[:, used].T, leaving[:, last].T])
        return cls(image.shape[1], tail, head, chance)

    def push(self, x: Float[np.ndarray, "cells #members"]) -> Float[np.ndarray, "ends members"]:
        """Compute the distributions one step later; the last row is for the sink."""
        later = np.zeros((self.cells + 1, max(x.shape[1], self.chance.shape[1])))
        self._arriving.add(later, self.chance * x[self.tail])
        return later

    def matrix(self, member: int = 0) -> scipy.sparse.csr_array:
        """Return the transition matrix of a member."""
        inside = self.head < self.cells
        steps = self.chance[inside, member], (self.tail[inside], self.head[inside])
        return scipy.sparse.csr_array(steps, shape=(self.cells, self.cells))

    @functools.cached_property
    def _arriving(self) -> Sums:
        return Sums.of(self.head)


def rows(array: np.ndarray, axes: int, lead: tuple[int, ...]) -> np.ndarray:
    """Return a row per member of a batch with axes `lead` for an array with `axes` other axes.

    The rows of an array without axes of the batch are one row in memory.
    """
    own = array.shape[array.ndim - axes :]
    if array.size == math.prod(own):
        return np.broadcast_to(array.reshape(own), (math.prod(lead), *own))
    return np.broadcast_to(array, lead + own).reshape(-1, *own)


def alike(slots: list[np.ndarray], args: list[np.ndarray]) -> Iterator[Int[np.ndarray, "members"]]:
    """Divide members by the possible steps of their chains and by their arguments but numbers.

    Arrays have a row per member; `slots` are the images and probabilities of chains.
    """
    parts = []
    for number, array in enumerate([*slots, *args]):
        if array.strides[0] == 0:
            continue
        if array.dtype.kind != "f":
            parts.append(array)
        elif number < len(slots):
            parts += [np.packbits(x > 0, axis=-1) for x in (array, leaving_slots(array))]
    first = [*slots, *args][0]
    found: dict[tuple[bytes, ...], list[int]] = {}
    for member in range(len(first)):
        found.setdefault(tuple(part[member].tobytes() for part in parts), []).append(member)
    most = max(1, _PART // first[0].size)
    for members in found.values():
        yield from np.array_split(members, -(-len(members) // most))
