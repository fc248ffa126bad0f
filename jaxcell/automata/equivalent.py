import numpy as np
from jaxtyping import Int, Int32, Integer, Shaped


def equivalence(
    images: Integer[np.ndarray, "inputs states"], observations: Shaped[np.ndarray, "inputs states"]
) -> Int32[np.ndarray, "states"]:
    """Find the equivalence classes of the states of a machine with inputs and observations.

    Two states are *equivalent* if every sequence of inputs gives the same observations from both.

    The partition of the states is refined until under each input the images of a class are in one
    class. First each input is repeated alone: `i` sorts of the states compare up to `2^i` repeats,
    so a long corridor needs few sorts. Then all inputs refine the partition together. Only states
    with an image whose class has changed are examined again (Hopcroft 1971).

    **Arguments:**

    - `images`: the state after each input.
    - `observations`: the observation between each state and its image; any sortable values.

    **Returns:** the class of each state. Classes are numbered in the order of smallest states.

    Four states in a circle: a bell rings in states 0 and 2. States 0 and 2 are equivalent, and so
    are states 1 and 3:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> automata.equivalence(np.array([[1, 2, 3, 0]]), np.array([[1, 0, 1, 0]])).tolist()
        [0, 1, 0, 1]
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
    return number[inverse]


def _along(
    image: Integer[np.ndarray, "states"], label: Int[np.ndarray, "states"]
) -> Int[np.ndarray, "states"]:
    """Split classes `label` where repeats of an input, with images `image`, distinguish states."""
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
    """Return the rank of each pair `(a[i], b[i])`, where `b >= 0`, among the distinct pairs."""
    key = a.astype(np.int64) * (int(b.max(initial=0)) + 1) + b
    return np.unique(key, return_inverse=True)[1]


def _refined(
    images: Integer[np.ndarray, "inputs states"], label: Int[np.ndarray, "states"]
) -> Int[np.ndarray, "states"]:
    """Split the classes `label` until each input maps every class into one class."""
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
