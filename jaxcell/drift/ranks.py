"""Ranks of groups, by which they are numbered and coloured alike in all layers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment


# So many groups of a layer are looked for in the next; the others are tiny.
_MAX_MATCHED = 200


def basin_ranks(
    basins: Sequence[Int[np.ndarray, "rows columns"]],
) -> list[Int[np.ndarray, "_groups"]]:
    """The ranks of groups in layers that lie one over the other.

    At the top they are by the size of the basins. Below, a group has the rank of that above it with
    which its basin has most in common, each rank going to one group; others come after all ranks
    so far, by size.

    **Arguments:**

    - `basins`: of each layer, the group of each square, or -1.

    Two groups that change places below, where there is a third one:

        >>> import numpy as np
        >>> from jaxcell.drift.ranks import basin_ranks
        >>> top, below = np.array([[0, 0, 0, 1, 1, -1]]), np.array([[1, 1, 2, 0, 0, -1]])
        >>> [one.tolist() for one in basin_ranks([top, below])]
        [[0, 1], [1, 0, 2]]
    """
    found: list[np.ndarray] = []
    above, given = np.full_like(basins[0], -1), 0
    for basin in basins:
        size = np.bincount(basin[basin >= 0])
        rank = np.full(size.size, -1)
        if found and size.size:
            colored = np.argsort(found[-1])[:_MAX_MATCHED]
            place = np.full(found[-1].size + 1, -1)
            place[colored] = np.arange(colored.size)
            both = (place[above] >= 0) & (basin >= 0)
            shared = np.zeros((colored.size, size.size))
            np.add.at(shared, (place[above[both]], basin[both]), 1)
            one, other = linear_sum_assignment(shared, maximize=True)
            same = shared[one, other] > 0
            rank[other[same]] = found[-1][colored[one[same]]]
        others = np.flatnonzero(rank < 0)
        rank[others] = given + np.argsort(np.argsort(-size[others], kind="stable"))
        found.append(rank)
        above, given = basin, max(given, 1 + rank.max(initial=-1))
    return found
