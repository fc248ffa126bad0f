import dataclasses

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Bool, Int, UInt64

from ..base.certificate import Certificate
from ..base.quiet import no_output


# Of the number of sets: HiGHS bounds it to about 1e-6.
_ROUNDING = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class Cover:
    """Sets that together hold every element that any set holds."""

    chosen: Int[np.ndarray, "steps"]
    "The sets, in the order in which they were chosen."
    gained: Int[np.ndarray, "steps"]
    "How many elements each of them holds that none before it does."
    uncovered: Int[np.ndarray, "missing"]
    "The elements that no set holds."


@dataclasses.dataclass(frozen=True, eq=False)
class MinimumCover:
    """As few sets as possible that together hold every element that any set holds."""

    chosen: Int[np.ndarray, "chosen"]
    "The sets, in order of their numbers."
    uncovered: Int[np.ndarray, "missing"]
    "The elements that no set holds."
    bound: int
    "No fewer sets than this will do."
    certificate: Certificate


def greedy_cover(sets: Bool[np.ndarray, "sets elements"], choice: int = 0) -> Cover:
    """Cover all elements, one set after the other (Alam 2018, Alg. 4.3; Chvatal 1979).

    Every step ranks the sets by how many elements they would gain, the first of equals first, and
    takes the best one, or with another `choice` the one that comes so many places after it. Where
    fewer sets gain anything at all, it takes the last of those: the source leaves open what to do
    then, and a set that gains nothing would be chosen for ever.

    With `choice` 0 there are at most `1 + 1/2 + ... + 1/d` times as many sets as needed, where `d`
    is the size of the largest.

    **Arguments:**

    - `sets`: which elements each set holds.
    - `choice`: the place in the ranking, from 0; robot `i` of several takes choice `i`, so that
        their covers differ.

    **Returns:** [`Cover`][].

    **Raises:** `ValueError` for a negative choice.

    The first two of three sets hold all elements:

        >>> import numpy as np
        >>> from jaxcell import optimize
        >>> sets = np.array([[True, True, False], [False, True, True], [False, False, True]])
        >>> optimize.greedy_cover(sets).chosen.tolist()
        [0, 1]
    """
    if choice < 0:
        raise ValueError(f"choice: expected a place in the ranking, at least 0, got {choice}")
    words = _packed(sets)
    gain = np.bitwise_count(words).sum(axis=0, dtype=np.int32)
    left = np.bitwise_or.reduce(words, axis=1)
    chosen, gained = [], []
    while gain.any():
        best = _ranked(gain, choice)
        chosen.append(best)
        gained.append(int(gain[best]))
        new = words[:, best] & left
        left ^= new
        # Only words that lose elements are counted again: a room's cells in view lie in few.
        some = np.flatnonzero(new)
        lost = np.bitwise_count(words[some] & new[some, None])
        gain -= lost.sum(axis=0, dtype=np.int32)
    return Cover(
        np.array(chosen, np.int32),
        np.array(gained, np.int32),
        np.flatnonzero(~sets.any(axis=0)).astype(np.int32),
    )


def minimum_cover(
    sets: Bool[np.ndarray, "sets elements"],
    *,
    time_limit: float | None = None,
    throw: bool = True,
) -> MinimumCover:
    """Cover all elements with the fewest sets, by a mixed-integer program.

    A yardstick for [`greedy_cover`][]: the time grows exponentially with the number of sets in bad
    cases. It is a fraction of a second for 200 cells of a room.

    **Arguments:**

    - `sets`: which elements each set holds.
    - `time_limit`: seconds after which the best cover so far has to do; by default there is none.
    - `throw`: whether to raise when that may not be the smallest.

    **Returns:** [`MinimumCover`][]. The residual of its certificate is how many sets fewer might
    do. Iterations are the nodes of the branch and bound.

    **Raises:** `RuntimeError` if time runs out, or if the solver fails.

    The greedy cover begins with the largest set, and then needs two more:

        >>> import numpy as np
        >>> from jaxcell import optimize
        >>> sets = np.array([[0, 1, 1, 1, 1, 0], [1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]], bool)
        >>> optimize.greedy_cover(sets).chosen.tolist()
        [0, 1, 2]
        >>> optimize.minimum_cover(sets).chosen.tolist()
        [1, 2]
    """
    greedy = greedy_cover(sets)
    if greedy.chosen.size == 0:
        return MinimumCover(greedy.chosen, greedy.uncovered, 0, Certificate(0, 0.0, 0.0))
    rows = scipy.sparse.csr_array(sets.T[sets.any(axis=0)], dtype=np.float64)
    with no_output():
        found = scipy.optimize.milp(
            np.ones(len(sets)),
            integrality=np.ones(len(sets)),
            bounds=scipy.optimize.Bounds(0, 1),
            constraints=scipy.optimize.LinearConstraint(rows, 1, np.inf),
            options={"mip_rel_gap": 0} | ({} if time_limit is None else {"time_limit": time_limit}),
        )
    if found.status not in (0, 1):
        raise RuntimeError(f"minimum_cover: HiGHS gave no answer: {found.message}")
    chosen = np.sort(greedy.chosen)
    if found.x is not None and np.count_nonzero(found.x > 0.5) < chosen.size:
        chosen = np.flatnonzero(found.x > 0.5).astype(np.int32)
    # Without a bound from the solver, that it takes one set is all that is known.
    below = 1.0 if found.mip_dual_bound is None else found.mip_dual_bound
    bound = max(1, int(np.ceil(below - _ROUNDING)))
    certificate = Certificate(int(found.mip_node_count or 0), float(chosen.size - bound), 0.0)
    certificate.check("minimum_cover", throw)
    return MinimumCover(chosen, greedy.uncovered, bound, certificate)


def _packed(sets: Bool[np.ndarray, "sets elements"]) -> UInt64[np.ndarray, "words sets"]:
    """The elements of each set as bits, with the sets along the rows that a step reads."""
    octets = np.packbits(sets, axis=1)
    whole = np.pad(octets, ((0, 0), (0, -octets.shape[1] % 8)))
    return np.ascontiguousarray(whole.view(np.uint64).T)


def _ranked(gain: Int[np.ndarray, "sets"], choice: int) -> int:
    """The set at a place of the ranking, or the last that gains anything."""
    choice = min(choice, int(np.count_nonzero(gain)) - 1)
    value = np.partition(gain, -1 - choice)[-1 - choice]
    return int(np.flatnonzero(gain == value)[choice - np.count_nonzero(gain > value)])
