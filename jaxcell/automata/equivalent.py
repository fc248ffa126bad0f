import dataclasses
from collections import deque

import numpy as np
from jaxtyping import Int, Int32, Integer, Shaped


@dataclasses.dataclass(frozen=True, eq=False)
class Equivalence:
    """The equivalence classes of the states of a machine with inputs and observations.

    Two states are *equivalent* if every sequence of inputs gives the same observations from both.
    The states of a class are equivalent because under each input they give the same observation and
    their images are in one class. [`Equivalence.distinguish`][] proves that two classes differ.
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

        Of several shortest sequences it returns the first in lexicographic order.

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

    The partition of the states is refined until under each input the images of a class are in one
    class. First it is refined by repeats of each single input: `i` sorts find all differences after
    up to `2^i` repeats, so that a long corridor takes few sorts. Then it is refined by all inputs,
    in rounds. A round examines only states with an image whose class has changed (Hopcroft 1971).

    **Arguments:**

    - `images`: the state after each input.
    - `observations`: the observation between each state and its image; any sortable values.

    **Returns:** [`Equivalence`][].

    A bell rings in state 2 of a ring of three states. Input 0 moves along the ring, and input 1
    stays. One input distinguishes states 0 and 2, and two distinguish 0 and 1:

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
    """Split the classes of states that repeats of one input distinguish; return the new labels."""
    # Singletons keep their labels; only other classes are sorted.
    jump, count = image, int(label.max()) + 1
    while True:
        alone = np.bincount(label, minlength=count) == 1
        open_ = np.flatnonzero(~alone[label])
        refined = label.copy()
        refined[open_] = count + ranked(label[open_], label[jump[open_]])
        # Numbers without gaps.
        used = np.bincount(refined) > 0
        if (more := int(np.count_nonzero(used))) == count:
            return label
        label, count, jump = (np.cumsum(used) - 1)[refined], more, jump[jump]


def ranked(a: Int[np.ndarray, "_"], b: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
    """Number the different pairs `(a[i], b[i])` in ascending order; return the number of each `i`.

    The entries of `b` are not negative.
    """
    key = a.astype(np.int64) * (int(b.max(initial=0)) + 1) + b
    return np.unique(key, return_inverse=True)[1]


def _refined(
    images: Integer[np.ndarray, "inputs states"], label: Int[np.ndarray, "states"]
) -> Int[np.ndarray, "states"]:
    """Split classes until under each input the images of a class are in one class."""
    label, count = label.copy(), int(label.max()) + 1
    size = np.bincount(label, minlength=label.size)
    into = np.argsort(images, axis=None, kind="stable")
    starts = np.searchsorted(images.ravel()[into], np.arange(label.size + 1))
    into %= label.size
    states = np.arange(label.size)
    while (states := states[size[label[states]] > 1]).size:
        part = label[states]
        for image in images:
            part = ranked(part, label[image[states]])
        _, first, length = np.unique(part, return_index=True, return_counts=True)
        owner = label[states[first]]
        # The states that were not examined keep the number of their class. If all were, the largest
        # part keeps it.
        new = np.ones(length.size, bool)
        order = np.lexsort((-length, owner))
        new[order[np.unique(owner[order], return_index=True)[1]]] = False
        new |= np.bincount(owner, length)[owner] < size[owner]
        number = count + np.cumsum(new) - 1
        count += int(np.count_nonzero(new))
        np.subtract.at(size, owner[new], length[new])
        size[number[new]] = length[new]
        moved = new[part]
        changed = states[moved]
        label[changed] = number[part[moved]]
        # The next states are those with an image in `changed`.
        begin, count_into = starts[changed], np.diff(starts)[changed]
        begin = np.repeat(begin - np.cumsum(count_into) + count_into, count_into)
        states = np.unique(into[begin + np.arange(begin.size)])
    return label
