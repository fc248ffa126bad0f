import dataclasses

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Bool, Float, Int, UInt64

from ..base.certificate import Certificate
from ..base.process import no_output
from ..base.shown import Shown


# Tolerance of the bound on the number of sets, which HiGHS computes to about 1e-6.
_ROUNDING = 1e-4
# Steps of the subgradient method, and the number after which they are half as long.
_DUAL_STEPS, _SLOWER = 600, 200


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


@dataclasses.dataclass(frozen=True, eq=False)
class LargestCover(Shown):
    """A few sets whose union is expected to contain many elements."""

    chosen: Int[np.ndarray, "steps"]
    "The sets, in the order in which they were chosen."
    gained: Float[np.ndarray, "steps"]
    "The expected number of elements that each chosen set adds."
    bound: float
    "An upper bound on the expected number of elements in the union of any sets of this number."


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


def largest_cover(
    shares: scipy.sparse.csr_array, count: int, allowed: Bool[np.ndarray, "sets"]
) -> LargestCover:
    """Choose a number of sets, one by one, each of which is expected to add the most elements.

    It runs on the host. The union is expected to contain at least the share `1 - 1/e` of the most
    elements that any `count` sets contain (Nemhauser, Wolsey and Fisher 1978). The bound is from
    the Lagrangian dual of the linear program.

    **Arguments:**

    - `shares`: the probability that a set (row) contains an element (column), independently.
    - `count`: the number of sets. There are fewer if no other set adds an element.
    - `allowed`: the sets that may be chosen.

    **Returns:** [`LargestCover`][].

    Two of three sets:

        >>> import numpy as np
        >>> import scipy.sparse
        >>> from jaxcell import optimize
        >>> sets = scipy.sparse.csr_array([[1.0, 1, 0], [0, 1, 1], [0, 0, 0.5]])
        >>> cover = optimize.largest_cover(sets, 2, np.ones(3, bool))
        >>> cover.chosen.tolist(), cover.gained.tolist(), cover.bound
        ([0, 1], [2.0, 1.0], 3.0)
    """
    if count < 1:
        raise ValueError(f"count: expected 1 or more, got {count}")
    missing, chosen, gained = np.ones(shares.shape[1]), [], []
    for _ in range(count):
        gain = np.where(allowed, shares @ missing, 0.0)
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        chosen.append(best)
        gained.append(float(gain[best]))
        row = slice(*shares.indptr[best : best + 2])
        missing[shares.indices[row]] *= 1 - shares.data[row]
    bound = _bound(shares[allowed], count, missing, sum(gained, 0.0))
    return LargestCover(np.array(chosen, np.int32), np.array(gained), bound)


def _bound(
    shares: scipy.sparse.csr_array, count: int, weight: Float[np.ndarray, "elements"], least: float
) -> float:
    """Bound the elements of any `count` sets, by the subgradient method for the Lagrangian dual.

    A union contains an element with at most the probability `min(1, z)`, with `z` the sum of the
    shares of its sets, and `min(1, z) <= 1 - w + w z` for any weight `w` from 0 to 1. The steps are
    those of Polyak (1969) towards `least`, which some sets reach.
    """
    bound, count = np.inf, min(count, shares.shape[0])
    if not count:
        return least
    for step in range(_DUAL_STEPS):
        gain = shares @ weight
        top = np.argpartition(-gain, count - 1)[:count]
        value = float((1 - weight).sum() + gain[top].sum())
        bound = min(bound, value)
        slope = shares[top].sum(axis=0) - 1
        size = (value - least) / max(1.0, float(slope @ slope)) / (1 + step / _SLOWER)
        weight = np.clip(weight - size * slope, 0, 1)
    return max(min(bound, shares.shape[1]), least)


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
