"""What a file of a result holds: a box of members, of one chunk of the sweep or several."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from .spec import Chunk, Spec, packed


if TYPE_CHECKING:
    from .workers.work import Variable


# A file is not larger than this for more than one chunk.
_FILE_BYTES = 2**20


@dataclasses.dataclass(frozen=True)
class Boxes:
    """The chunks of a sweep in the boxes that files hold."""

    spec: Spec
    grid: Spec
    "The specification with boxes in the place of its chunks."

    @classmethod
    def of_lengths(cls, spec: Spec, lengths: tuple[int, ...]) -> "Boxes":
        """Boxes of so many members along each dimension."""
        named = dict(zip(spec.dimensions, lengths, strict=True))
        return cls(spec, dataclasses.replace(spec, lengths=named))

    def __iter__(self) -> Iterator[Chunk]:
        return map(self.grid.chunk, range(self.grid.chunk_count))

    @property
    def several(self) -> bool:
        """Whether a file may hold more than one chunk."""
        return self.grid.lengths != self.spec.lengths

    def around(self, chunk: Chunk) -> Chunk:
        """The box that holds a chunk."""
        lengths = self.grid.lengths.values()
        index = [part.start // each for part, each in zip(chunk.region, lengths, strict=True)]
        return self.grid.chunk(int(np.ravel_multi_index(index, self.grid.chunk_grid)))

    def numbers(self) -> np.ndarray:
        """The number of the box that holds each chunk, by its number."""
        lengths = zip(self.spec.lengths.values(), self.grid.lengths.values(), strict=True)
        along = [
            np.arange(count) * chunk // box
            for count, (chunk, box) in zip(self.spec.chunk_grid, lengths, strict=True)
        ]
        grid = self.grid.chunk_grid
        return np.arange(self.grid.chunk_count).reshape(grid)[np.ix_(*along)].ravel()


def stored_lengths(spec: Spec, variables: "Mapping[str, Variable]") -> tuple[int, ...]:
    """How many members lie in a file along each dimension: those of whole chunks.

    **Arguments:**

    - `spec`: the specification of the sweep.
    - `variables`: what the task gave for one of the chunks.
    """
    arrays = [one.values for one in variables.values()]
    member_bytes = max([1, *(one.itemsize * math.prod(one.shape[1:]) for one in arrays)])
    chunk_bytes = member_bytes * math.prod(spec.lengths.values())
    count = max(_FILE_BYTES // chunk_bytes, 1)
    grid = dict(zip(spec.dimensions, spec.chunk_grid, strict=True))
    return tuple(spec.lengths[name] * along for name, along in packed(grid, count).items())


def inside(chunk: Chunk, box: Chunk) -> tuple[slice, ...]:
    """The places of a chunk in the box that holds it."""
    return tuple(
        slice(part.start - whole.start, part.stop - whole.start)
        for part, whole in zip(chunk.region, box.region, strict=True)
    )


def by_chunk(spec: Spec, reduce: np.ufunc, members: np.ndarray) -> np.ndarray:
    """What all members of each chunk are together, by its number."""
    for axis, length in enumerate(spec.lengths.values()):
        members = reduce.reduceat(members, np.arange(0, members.shape[axis], length), axis)
    return members.ravel()
