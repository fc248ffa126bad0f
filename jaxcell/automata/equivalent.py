import dataclasses
from collections import deque

import numpy as np
from jaxtyping import Int, Int32, Integer, Shaped


@dataclasses.dataclass(frozen=True, eq=False)
class Equivalence:
    """The equivalence classes of the states of a machine with inputs and observations.

    Two states are *equivalent* if every sequence of inputs gives the same observations from both.
    States are proved equivalent if the images of each class under an input are in one class, with
    one observation; [`Equivalence.distinguish`][] proves that two classes differ.
    """

    images: Integer[np.ndarray, "inputs states"]
    "The state after each input."
    observations: Shaped[np.ndarray, "inputs states"]
    "The observation between each state and its image."
    label: Int32[np.ndarray, "states"]
    "The class of each state; classes are numbered in the order of their smallest states."

    @property
    def count(self) -> int:
        """Number of classes."""
        return int(self.label.max()) + 1

    def distinguish(self, a: int, b: int) -> Int[np.ndarray, "length"]:
        """Find a shortest sequence of inputs whose last observation differs between two states.

        Of several shortest sequences it is the first in lexicographic order.

        **Raises:** `ValueError` if the states are equivalent, or if a state does not exist.
        """
        for state in (a, b):
            if not 0 <= state < self.label.size:
                raise ValueError(
                    f"state {state} does not exist; states are 0 to {self.label.size - 1}"
                )
        if self.label[a] == self.label[b]:
            raise ValueError(f"states {a} and {b} are equivalent: no inputs distinguish them")
        image, observation, label = self.images.item, self.observations.item, self.label.item
        start = (min(a, b), max(a, b))
        before: dict[tuple[int, int], tuple[tuple[int, int], int] | None] = {start: None}
        queue = deque([start])
        while True:
            here = queue.popleft()
            x, y = here
            for i in range(len(self.images)):
                if observation(i, x) != observation(i, y):
                    word = [i]
                    while (step := before[here]) is not None:
                        here, i = step
                        word.append(i)
                    return np.array(word[::-1])
                x_after, y_after = image(i, x), image(i, y)
                after = (min(x_after, y_after), max(x_after, y_after))
                if label(x_after) != label(y_after) and after not in before:
                    before[after] = (here, i)
                    queue.append(after)


def equivalence(
    images: Integer[np.ndarray, "inputs states"], observations: Shaped[np.ndarray, "inputs states"]
) -> Equivalence:
    """Find the classes of states that no sequence of inputs distinguishes.

    The partition of the states is refined until the images of a class are in one class. It is first
    refined along each input separately, by doubling: the differences within `2^i` repeats of an
    input take `i` sorts, so that a long corridor takes a number of sorts logarithmic in its length.
    Then it is refined along all inputs, in rounds: of a class that splits, the largest part keeps
    its number, and only states that lead to the other parts are examined again, so that each state
    is examined a logarithmic number of times (Hopcroft 1971).

    **Arguments:**

    - `images`: the state after each input.
    - `observations`: the observation between each state and its image; any sortable values.

    **Returns:** [`Equivalence`][].

    A ring of three states; input 0 moves along it, input 1 stays, and the bell of state 2 rings.
    One input distinguishes states 0 and 2, and two distinguish 0 and 1:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> images = np.array([[1, 2, 0], [0, 1, 2]])
        >>> classes = automata.equivalence(images, np.array([[0, 0, 1], [0, 0, 0]]))
        >>> classes.label.tolist(), classes.distinguish(0, 1).tolist()
        ([0, 1, 2], [0, 0])
    """
    if images.ndim != 2 or images.size == 0:
        raise ValueError(f"images: expected at least one input and state, got {images.shape}")
    if observations.shape != images.shape:
        raise ValueError(
            f"observations: expected one per input and state, of shape {images.shape}, got "
            f"{observations.shape}"
        )
    outside = np.argwhere((images < 0) | (images >= images.shape[1]))
    if outside.size:
        i, state = outside[0].tolist()
        raise ValueError(
            f"images[{i}, {state}] is {images[i, state]}; expected a state from 0 to "
            f"{images.shape[1] - 1}"
        )
    label = np.zeros(images.shape[1], np.int64)
    for row in observations:
        label = ranked(label, np.unique(row, return_inverse=True)[1])
    for image in images:
        label = _along(image, label)
    label = _refined(images, label)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    number = np.empty(first.size, np.int32)
    number[np.argsort(first)] = np.arange(first.size, dtype=np.int32)
    return Equivalence(images, observations, number[inverse])


def _along(
    image: Integer[np.ndarray, "states"], label: Int[np.ndarray, "states"]
) -> Int[np.ndarray, "states"]:
    """Refine labels by repeats of one input."""
    # Singletons keep their labels; only other classes are sorted.
    jump, count = image, int(label.max()) + 1
    while True:
        alone = np.bincount(label, minlength=count) == 1
        open_ = np.flatnonzero(~alone[label])
        refined = label.copy()
        refined[open_] = count + ranked(label[open_], label[jump[open_]])
        refined, more = _compact(refined)
        if more == count:
            return label
        label, count, jump = refined, more, jump[jump]


def _compact(label: Int[np.ndarray, "states"]) -> tuple[Int[np.ndarray, "states"], int]:
    """Renumber labels without gaps. Returns them and their number."""
    used = np.zeros(int(label.max()) + 1, bool)
    used[label] = True
    return (np.cumsum(used) - 1)[label], int(used.sum())


def ranked(a: Int[np.ndarray, "_"], b: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
    """Number the different pairs, in their order."""
    key = a.astype(np.int64) * (int(b.max(initial=0)) + 1) + b
    return np.unique(key, return_inverse=True)[1]


def _refined(
    images: Integer[np.ndarray, "inputs states"], label: Int[np.ndarray, "states"]
) -> Int[np.ndarray, "states"]:
    """Compute the labels of the coarsest refinement that all inputs preserve."""
    blocks = _Blocks(label)
    into = np.argsort(images, axis=None, kind="stable")
    starts = np.searchsorted(images.ravel()[into], np.arange(label.size + 1))
    into %= label.size
    looked_at = np.arange(label.size)
    while looked_at.size:
        looked_at = looked_at[blocks.size[blocks.label[looked_at]] > 1]
        kind = np.zeros(looked_at.size, np.int64)
        for image in images:
            kind = ranked(kind, blocks.label[image[looked_at]])
        changed = blocks.split(looked_at, kind)
        before = into[_ranges(starts[changed], starts[changed + 1] - starts[changed])]
        looked_at = np.unique(before)
    return blocks.label


class _Blocks:
    """A partition whose blocks are consecutive in `order`."""

    def __init__(self, label: Int[np.ndarray, "states"]) -> None:
        self.label = label.copy()
        self.order = np.argsort(label, kind="stable")
        self.place = np.empty_like(self.order)
        self.place[self.order] = np.arange(label.size)
        # There is room for as many blocks as states.
        self.count = int(label.max()) + 1
        self.size = np.zeros(label.size, np.int64)
        self.size[: self.count] = np.bincount(label)
        self.begin = np.zeros(label.size, np.int64)
        self.begin[: self.count] = np.cumsum(self.size[: self.count]) - self.size[: self.count]

    def split(
        self, states: Int[np.ndarray, "some"], kind: Int[np.ndarray, "some"]
    ) -> Int[np.ndarray, "changed"]:
        """Split blocks by the kinds of `states`; all other states have another kind.

        Returns the states whose block has a new number: all but those of the largest parts.
        """
        sort = np.lexsort((kind, self.label[states]))
        states, kind, block = states[sort], kind[sort], self.label[states[sort]]
        parts = np.flatnonzero(_changes(block) | _changes(kind))
        length = np.diff(np.append(parts, states.size))
        owner = block[parts]
        firsts = np.flatnonzero(_changes(owner))
        touched = owner[firsts]
        moved = np.add.reduceat(length, firsts) if touched.size else length
        rest = self.size[touched] - moved
        self._move_to_end(states, touched, moved)

        # The parts of a block: its other states, and then each kind.
        owner = np.concatenate([touched[rest > 0], owner])
        length = np.concatenate([rest[rest > 0], length])
        begin = np.concatenate([self.begin[touched[rest > 0]], self.place[states[parts]]])
        sort = np.lexsort((-length, owner))
        owner, length, begin = owner[sort], length[sort], begin[sort]
        largest = _changes(owner)
        self.size[owner[largest]], self.begin[owner[largest]] = length[largest], begin[largest]
        new = slice(self.count, self.count + int((~largest).sum()))
        self.count = new.stop
        self.size[new], self.begin[new] = length[~largest], begin[~largest]
        changed = self.order[_ranges(self.begin[new], self.size[new])]
        self.label[changed] = np.repeat(np.arange(new.start, new.stop), self.size[new])
        return changed

    def _move_to_end(
        self,
        states: Int[np.ndarray, "some"],
        blocks: Int[np.ndarray, "touched"],
        count: Int[np.ndarray, "touched"],
    ) -> None:
        """Move states, sorted by block, to the ends of their blocks, in their order."""
        tail = _ranges(self.begin[blocks] + self.size[blocks] - count, count)
        first = np.repeat(self.begin[blocks] + self.size[blocks] - count, count)
        vacated = self.place[states][self.place[states] < first]
        there = self.order[tail]
        self.place[states] = -1
        displaced = there[self.place[there] >= 0]
        self.order[vacated], self.place[displaced] = displaced, vacated
        self.order[tail], self.place[states] = states, tail


def _changes(values: Int[np.ndarray, "_"]) -> np.ndarray:
    """Return a mask of the values that differ from the preceding value, and of the first value."""
    return np.append(np.ones(min(values.size, 1), bool), values[1:] != values[:-1])


def _ranges(begin: Int[np.ndarray, "_"], length: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
    """Concatenate the numbers of ranges."""
    before = np.cumsum(length) - length
    return np.repeat(begin - before, length) + np.arange(int(length.sum()))
