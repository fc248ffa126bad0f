"""Ranks of groups: matching groups of different layers have the same number and colour."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment


# Only this number of the largest groups of a layer is matched with groups of the next layer.
_MAX_MATCHED = 200


def basin_ranks(
    basins: Sequence[Int[np.ndarray, "rows columns"]],
) -> list[Int[np.ndarray, "_groups"]]:
    """Rank the groups of each layer so that matching groups of different layers have equal ranks.

    `basins` contains, for each layer, the group of each square, or -1. In the first layer groups
    are ranked by the sizes of their basins. In each following layer, groups are matched one to one
    with groups of the layer above, so that the overlap of basins is largest. Groups without a match
    get new ranks, by size. In this example the numbers of two groups are swapped in the second
    layer, which has a third group, too:

        >>> import numpy as np
        >>> from jaxcell.drift.matched_ranks import basin_ranks
        >>> top, below = np.array([[0, 0, 0, 1, 1, -1]]), np.array([[1, 1, 2, 0, 0, -1]])
        >>> [rank.tolist() for rank in basin_ranks([top, below])]
        [[0, 1], [1, 0, 2]]
    """
    ranks: list[np.ndarray] = []
    above, used = np.full_like(basins[0], -1), 0
    for basin in basins:
        size = np.bincount(basin[basin >= 0])
        rank = np.full(size.size, -1)
        if ranks and size.size:
            candidates = np.argsort(ranks[-1])[:_MAX_MATCHED]
            place = np.full(ranks[-1].size + 1, -1)
            place[candidates] = np.arange(candidates.size)
            both = (place[above] >= 0) & (basin >= 0)
            shared = np.zeros((candidates.size, size.size))
            np.add.at(shared, (place[above[both]], basin[both]), 1)
            upper, lower = linear_sum_assignment(shared, maximize=True)
            overlap = shared[upper, lower] > 0
            rank[lower[overlap]] = ranks[-1][candidates[upper[overlap]]]
        new = np.flatnonzero(rank < 0)
        rank[new] = used + np.argsort(np.argsort(-size[new], kind="stable"))
        ranks.append(rank)
        above, used = basin, max(used, 1 + rank.max(initial=-1))
    return ranks
