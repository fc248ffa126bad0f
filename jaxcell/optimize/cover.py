import dataclasses

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Bool, Int, UInt64

from ..base.certificate import Certificate
from ..base.process import no_output
from ..base.shown import Shown


# Tolerance of the bound on the number of sets, which HiGHS computes to about 1e-6.
_ROUNDING = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class Cover(Shown):
    """A set cover: chosen sets whose union contains every element of every set."""

    chosen: Int[np.ndarray, "steps"]
    "The sets, in the order in which they were chosen."
    gained: Int[np.ndarray, "steps"]
    "The number of elements that each chosen set adds."
    uncovered: Int[np.ndarray, "missing"]
    "The elements that no set contains."


@dataclasses.dataclass(frozen=True, eq=False)
class MinimumCover(Shown):
    """A smallest set cover: the fewest sets whose union contains every element of every set."""

    chosen: Int[np.ndarray, "chosen"]
    "The sets, sorted by their numbers."
    uncovered: Int[np.ndarray, "missing"]
    "The elements that no set contains."
    bound: int
    "A lower bound on the number of sets."
    certificate: Certificate


def greedy_cover(sets: Bool[np.ndarray, "sets elements"], choice: int = 0) -> Cover:
    """Choose sets that cover all elements, one by one (Alam 2018, Alg. 4.3; Chvatal 1979).

    It runs on the host, because the number of sets depends on the values.

    Each step ranks the sets by the number of elements that they would add; sets that add equally
    many keep their order. The step takes the best set, or with `choice` k the set k places below
    it. If too few sets add elements, the step takes the last set that adds elements; the source
    leaves this open.

    **Arguments:** the mask of the elements of each set; and the position in the ranking, from 0.
    Robot `i` of a team takes position `i`, so that the covers of robots differ. **Returns:**
    [`Cover`][].

    The first two of three sets contain all elements:

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
        # Only words that lose elements are counted again; cells in view of a cell are in few words.
        changed = np.flatnonzero(new)
        lost = np.bitwise_count(words[changed] & new[changed, None])
        gain -= lost.sum(axis=0, dtype=np.int32)
    return Cover(
        np.array(chosen, np.int32),
        np.array(gained, np.int32),
        np.flatnonzero(~sets.any(axis=0)).astype(np.int32),
    )


def minimum_cover(
    sets: Bool[np.ndarray, "sets elements"], *, time_limit: float | None = None, throw: bool = True
) -> MinimumCover:
    """Choose the fewest sets that cover all elements, with a mixed-integer program.

    It runs on the host, because HiGHS solves the program.

    In bad cases the computing time grows exponentially with the number of sets; a room of 200 cells
    takes a fraction of a second.

    **Arguments:**

    - `sets`: the mask of the elements of each set.
    - `time_limit`: seconds after which the best cover so far is returned; by default no limit.
    - `throw`: whether to raise `RuntimeError` if the cover may not be the smallest.

    **Returns:** [`MinimumCover`][]. The residual of its certificate is the largest number of sets
    that a smaller cover might save. Iterations are the nodes of the branch and bound.

    The greedy cover starts with the largest set, and then needs two more sets:

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
        program = scipy.optimize.milp(
            np.ones(len(sets)),
            integrality=np.ones(len(sets)),
            bounds=scipy.optimize.Bounds(0, 1),
            constraints=scipy.optimize.LinearConstraint(rows, 1, np.inf),
            options={"mip_rel_gap": 0} | ({} if time_limit is None else {"time_limit": time_limit}),
        )
    if program.status not in (0, 1):
        raise RuntimeError(f"minimum_cover: HiGHS found no solution: {program.message}")
    chosen = np.sort(greedy.chosen)
    if program.x is not None and np.count_nonzero(program.x > 0.5) < chosen.size:
        chosen = np.flatnonzero(program.x > 0.5).astype(np.int32)
    # If the solver returns no bound, the bound is one set.
    below = 1.0 if program.mip_dual_bound is None else program.mip_dual_bound
    bound = max(1, int(np.ceil(below - _ROUNDING)))
    certificate = Certificate(int(program.mip_node_count or 0), float(chosen.size - bound), 0.0)
    certificate.check("minimum_cover", throw)
    return MinimumCover(chosen, greedy.uncovered, bound, certificate)


def _packed(sets: Bool[np.ndarray, "sets elements"]) -> UInt64[np.ndarray, "words sets"]:
    """Pack the elements of each set as bits, 64 in a word; there is one column per set."""
    octets = np.packbits(np.ascontiguousarray(sets), axis=1)
    whole = np.pad(octets, ((0, 0), (0, -octets.shape[1] % 8)))
    return np.ascontiguousarray(whole.view(np.uint64).T)


def _ranked(gain: Int[np.ndarray, "sets"], choice: int) -> int:
    """Return the set at position `choice` of the ranking, or the last set that adds elements."""
    choice = min(choice, int(np.count_nonzero(gain)) - 1)
    value = np.partition(gain, -1 - choice)[-1 - choice]
    return int(np.flatnonzero(gain == value)[choice - np.count_nonzero(gain > value)])
