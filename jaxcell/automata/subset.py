import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Int32, Int64, Integer, UInt64

from ..base.memory import check
from ..base.shown import Shown


@dataclasses.dataclass(frozen=True, eq=False)
class Automaton(Shown):
    """A deterministic I-state automaton: each state is a set of possible cells of the robot.

    State 0 is the start. States are numbered in breadth-first order, observation 0 before 1.
    """

    transition: Int32[np.ndarray, "states 2"]
    "The state after observation 0 or 1, or -1 if no cell of the state gives that observation."
    offsets: Int64[np.ndarray, "states+1"]
    "The cells of state `i` are `members[offsets[i] : offsets[i + 1]]`."
    members: Int32[np.ndarray, "total"]
    "The possible cells in each state, in ascending order, one state after the other."


def subset_construction(
    image: Integer[np.ndarray, "cells"],
    observation: Bool[np.ndarray, "cells"],
) -> Automaton:
    """Build the deterministic automaton of the I-state graph of a map (Alam 2018, section 2.4.3).

    The states are the non-empty sets of cells that are possible after observation strings; at the
    start all cells are possible. The sets of a level of the breadth-first search are mapped
    together. A set is identified by a hash, the sum of one random 64-bit word per cell. Sets with
    equal hashes are compared cell by cell, so the result is exact. A map that does not preserve the
    order of the cells takes an additional sort at each level.

    **Arguments:**

    - `image`: the image of each cell.
    - `observation`: whether the robot observes 1 (a bump) between a cell and its image.

    **Returns:** [`Automaton`][].

    **Raises:** `MemoryError` if the sets exceed the free memory.

    Three cells in a ring, with a bump between cells 2 and 0. The states are the sets `{0, 1, 2}`,
    `{1, 2}`, `{0}`, `{2}` and `{1}`:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> image, bumped = np.array([1, 2, 0]), np.array([False, False, True])
        >>> automaton = automata.subset_construction(image, bumped)
        >>> automaton.transition.tolist()
        [[1, 2], [3, 2], [4, -1], [-1, 2], [3, -1]]
        >>> automaton.members.tolist()
        [0, 1, 2, 1, 2, 0, 2, 1]
    """
    if image.size == 0:
        raise ValueError("image: there are no cells; expected at least one")
    outside = np.flatnonzero((image < 0) | (image >= image.size))
    if outside.size:
        cell = outside[0]
        raise ValueError(
            f"image[{cell}] is {image[cell]}; expected a cell from 0 to {image.size - 1}"
        )
    image = image.astype(np.int32)
    graph = _Graph(
        image,
        observation,
        tuple(bool(np.all(np.diff(image[observation == bit]) > 0)) for bit in (False, True)),
    )
    seed = 0
    while True:
        try:
            return _construct(graph, random_words(image.size, seed))
        except _HashCollisionError:
            seed += 1


@dataclasses.dataclass(frozen=True)
class _Graph:
    image: Int32[np.ndarray, "cells"]
    observation: Bool[np.ndarray, "cells"]
    increasing: tuple[bool, ...]
    "For each observation, `True` if larger cells have larger images, so sorted sets stay sorted."


class _HashCollisionError(Exception):
    """Two different sets have the same hash."""


class _Subsets:
    """The sets found so far, in the order of their states, and the edges between the states."""

    def __init__(self, words: UInt64[np.ndarray, "cells"]):
        self.words = words
        self.members = np.arange(words.size, dtype=np.int32)
        self.offsets = [0, words.size]
        self.table = {int(np.sum(words)): 0}
        self.edges: list[int] = []
        self.targets: list[int] = []

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def append(self, sets: list[Int32[np.ndarray, "_"]]) -> None:
        begin = self.offsets[-1]
        self.offsets.extend(itertools.accumulate(map(len, sets[1:]), initial=begin + len(sets[0])))
        end = self.offsets[-1]
        if end > self.members.size:
            size = max(end, self.members.size * 5 // 4)
            check(
                (size - self.members.size) * self.members.itemsize,
                f"a filter of more than {len(self)} states",
                "use larger cells or fewer directions",
            )
            # The system's realloc moves pages, not bytes. No other view of this buffer exists here.
            self.members.resize(size, refcheck=False)
        np.concatenate(sets, out=self.members[begin:end])


def _construct(graph: _Graph, words: UInt64[np.ndarray, "cells"]) -> Automaton:
    sets = _Subsets(words)
    low, high = 0, 1
    while low < high:
        _add_successors(graph, sets, low, high)
        low, high = high, len(sets)
    sets.members.resize(sets.offsets[-1], refcheck=False)
    transition = np.full(2 * len(sets), -1, np.int32)
    transition[sets.edges] = sets.targets
    return Automaton(transition.reshape(-1, 2), np.array(sets.offsets, np.int64), sets.members)


def _add_successors(graph: _Graph, subsets: _Subsets, low: int, high: int) -> None:
    """Add the successors of the sets `low` to `high - 1`, one level of a breadth-first search."""
    bounds = np.array(subsets.offsets[low : high + 1])
    cells = subsets.members[bounds[0] : bounds[-1]]
    bounds -= bounds[0]
    bumped = graph.observation[cells]
    bumps = np.flatnonzero(bumped)
    ones = np.diff(np.searchsorted(bumps, bounds))
    zeros = np.diff(bounds) - ones
    images_0, lengths_0 = _images(graph, 0, cells[~bumped], zeros[zeros > 0])
    images_1, lengths_1 = _images(graph, 1, cells[bumps], ones[ones > 0])
    del cells

    images = np.concatenate([images_0, images_1])
    lengths = np.concatenate([lengths_0, lengths_1])
    edges = 2 * low + np.concatenate([2 * np.flatnonzero(zeros), 2 * np.flatnonzero(ones) + 1])
    ends = np.cumsum(lengths)
    starts = ends - lengths
    keys = np.add.reduceat(subsets.words[images], starts)

    order = np.argsort(edges)
    fresh = len(subsets)
    targets, new, known = [], [], []
    for key, start, end in zip(
        keys[order].tolist(), starts[order].tolist(), ends[order].tolist(), strict=True
    ):
        target = subsets.table.setdefault(key, fresh)
        if target == fresh:
            fresh += 1
            new.append(images[start:end])
        else:
            known.append((target, start, end - start))
        targets.append(target)
    if new:
        subsets.append(new)
    _check_equal(subsets, images, np.array(known, np.int64).reshape(-1, 3))
    subsets.edges.extend(edges[order].tolist())
    subsets.targets.extend(targets)


def _images(
    graph: _Graph, bit: int, cells: Int32[np.ndarray, "_"], lengths: Integer[np.ndarray, "sets"]
) -> tuple[Int32[np.ndarray, "_"], Integer[np.ndarray, "sets"]]:
    """Compute the images of sets, sorted and without repeats, and the sizes of the images.

    `cells` contains the sets one after the other, with sizes `lengths`; all give observation `bit`.
    """
    images = graph.image[cells]
    if graph.increasing[bit] or not lengths.size:
        return images, lengths
    base = np.arange(lengths.size + 1, dtype=np.int64) * graph.image.size
    keys = np.repeat(base[:-1], lengths) + images
    keys.sort()
    first = np.ones(keys.size, bool)
    np.not_equal(keys[1:], keys[:-1], out=first[1:])
    keys = keys[first]
    lengths = np.diff(np.searchsorted(keys, base))
    return (keys - np.repeat(base[:-1], lengths)).astype(np.int32), lengths


def _check_equal(
    subsets: _Subsets, images: Int32[np.ndarray, "_"], known: Int64[np.ndarray, "sets 3"]
) -> None:
    """Raise an error if an image has the same hash as a different set.

    Each row of `known` has a state, and the start and length in `images` of an image with its hash.
    """
    state, start, length = known.T
    begin = np.array([subsets.offsets[i] for i in state.tolist()], np.int64)
    end = np.array([subsets.offsets[i + 1] for i in state.tolist()], np.int64)
    if not np.array_equal(end - begin, length):
        raise _HashCollisionError
    within = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    here, there = np.repeat(start, length) + within, np.repeat(begin, length) + within
    if not np.array_equal(images[here], subsets.members[there]):
        raise _HashCollisionError


def random_words(cells: int, seed: int) -> UInt64[np.ndarray, "cells"]:
    return np.random.default_rng(seed).integers(0, 2**64, cells, dtype=np.uint64)
