"""Shortest walks through all sets of a few targets, by dynamic programming over sets.

A set of targets is a number whose bits are its members.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int


MOST_SUBSETS = 14
"Largest number of targets, whose sets are all computed."
MOST_ROBOTS = 4
"Largest number of robots among which sets are divided optimally."
# The weight of time between visits beside risk.
_TIE = 1e-6


def closed_tours(between: Float[np.ndarray, "targets targets"]) -> Float[np.ndarray, "sets"]:
    """Compute the length of the shortest closed tour of each set of targets."""
    count = len(between)
    # From the first member of each set through all members, ending at each.
    length = np.full((1 << count, count), np.inf)
    bit = 1 << np.arange(count)
    length[bit, np.arange(count)] = 0.0
    tours = np.zeros(1 << count)
    for visited in range(1, 1 << count):
        lowest = (visited & -visited).bit_length() - 1
        tours[visited] = (length[visited] + between[:, lowest]).min()
        new = np.flatnonzero(((visited & bit) == 0) & (bit > (visited & -visited)))
        if new.size:
            length[visited | bit[new], new] = (length[visited][:, None] + between[:, new]).min(
                axis=0
            )
    return tours


def open_walks(
    between: Float[np.ndarray, "targets targets"], latest: Float[np.ndarray, "targets"]
) -> Float[np.ndarray, "sets"]:
    """Compute the least time to visit each set, from any target, each of them by its latest time.

    The time is infinite if no walk does that."""
    count = len(between)
    length = np.full((1 << count, count), np.inf)
    bit = 1 << np.arange(count)
    length[bit, np.arange(count)] = 0.0
    for visited in range(1, 1 << count):
        new = np.flatnonzero((visited & bit) == 0)
        if new.size:
            when = (length[visited][:, None] + between[:, new]).min(axis=0)
            length[visited | bit[new], new] = np.where(
                when <= latest[new] * (1 + 1e-9), when, np.inf
            )
    length[0, 0] = 0.0
    return length.min(axis=1)


def of_several(single: Float[np.ndarray, "sets"], robots: int) -> Float[np.ndarray, "sets"]:
    """Compute the largest cost of the robots that divide each set, at the best division."""
    best = single
    for _ in range(min(robots, int(np.log2(len(single)))) - 1):
        best = np.array(
            [np.maximum(single[t], best[s ^ t]).min() for s, t in _all_parts(len(best))]
        )
    return best


def _all_parts(count: int) -> Iterator[tuple[int, Int[np.ndarray, "parts"]]]:
    for whole in range(count):
        yield whole, subsets_of(whole)


def subsets_of(whole: int) -> Int[np.ndarray, "parts"]:
    """Return all subsets of a set, among them the empty one."""
    parts = np.zeros(1, np.int64)
    while whole:
        parts = np.concatenate([parts, parts | (whole & -whole)])
        whole &= whole - 1
    return parts


def members(whole: int) -> list[int]:
    return [target for target in range(whole.bit_length()) if whole >> target & 1]


def membership(count: int) -> Bool[np.ndarray, "sets targets"]:
    """Return whether each target is a member of each set."""
    return (np.arange(1 << count)[:, None] >> np.arange(count)) & 1 == 1


def best_partition(
    tours: Float[np.ndarray, "sets"],
    attack: Float[np.ndarray, "targets"],
    value: Float[np.ndarray, "targets"],
    robots: int,
) -> Iterator[list[tuple[list[int], int]]]:
    """Divide targets and robots among closed tours: with the least risk, and in one tour.

    **Yields:** the targets and the number of robots of each tour; robots may be left over.
    """
    count = len(attack)
    whole = len(tours) - 1
    if np.isfinite(tours[whole]):
        yield [(members(whole), robots)]
    inside = membership(count)

    def cost(several: int) -> Float[np.ndarray, "sets"]:
        most = np.zeros(len(tours))
        with np.errstate(divide="ignore", invalid="ignore"):
            for target in range(count):
                late = tours / (several * attack[target])
                risk = value[target] * np.maximum(0.0, 1 - 1 / late) + _TIE * late
                most = np.maximum(most, np.where(inside[:, target] & (tours > 0), risk, 0.0))
        return most

    robots = min(robots, MOST_ROBOTS)
    yield best_division([cost(several) for several in range(1, robots + 1)], np.maximum)


def best_division(
    costs: Sequence[Float[np.ndarray, "sets"]], together: np.ufunc
) -> list[tuple[list[int], int]]:
    """Divide all targets among robots at the least cost.

    **Arguments:** `costs[n - 1]`, the cost of each set on a tour of `n` robots, and how the costs
    of two tours are joined, `np.maximum` or `np.add`. **Returns:** the targets and the number of
    robots of each tour; robots may be left over.
    """
    robots, whole = len(costs), len(costs[0]) - 1
    best, taken = [costs[0]], [np.zeros((whole + 1, 2), np.int64)]
    taken[0][:, 0], taken[0][:, 1] = np.arange(whole + 1), 1
    for several in range(2, robots + 1):
        least, choice = costs[several - 1].copy(), np.zeros((whole + 1, 2), np.int64)
        choice[:, 0], choice[:, 1] = np.arange(whole + 1), several
        sets = [whole] if several == robots else range(1, whole + 1)
        for one in sets:
            # The first member is in the part that is taken.
            low = one & -one
            parts = subsets_of(one ^ low) | low
            for own in range(1, several):
                both = together(costs[own - 1][parts], best[several - own - 1][one ^ parts])
                k = int(both.argmin())
                if both[k] < least[one]:
                    least[one], choice[one] = both[k], (parts[k], own)
        best.append(least)
        taken.append(choice)
    groups, left, several = [], whole, robots
    while left and several:
        part, own = taken[several - 1][left].tolist()
        groups.append((part, own))
        left, several = left ^ part, several - own
    return [(members(part), own) for part, own in groups]
