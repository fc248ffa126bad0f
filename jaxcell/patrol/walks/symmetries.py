import itertools
import operator
from collections.abc import Sequence
from typing import Any

import networkx
import numpy as np
from jaxtyping import Int


# Largest number of symmetries to find.
MOST_SYMMETRIES = 48


def symmetries(
    delays: Int[np.ndarray, "vertices vertices"], kinds: Sequence[Any]
) -> Int[np.ndarray, "symmetries vertices"]:
    """Find permutations of vertices that preserve durations of moves and kinds of vertices.

    **Returns:** the image of each vertex under each permutation, the identity first. If there are
    at most 48 permutations, all are returned and form a group; otherwise only some are.
    """
    graph = networkx.from_numpy_array(delays, create_using=networkx.DiGraph)
    networkx.set_node_attributes(graph, dict(enumerate(kinds)), "kind")
    alike: Any = {"node_match": operator.eq, "edge_match": operator.eq}
    found = networkx.isomorphism.DiGraphMatcher(graph, graph, **alike).isomorphisms_iter()
    every = [range(len(delays)), *itertools.islice(found, MOST_SYMMETRIES + 1)]
    unique = dict.fromkeys(tuple(each[here] for here in range(len(delays))) for each in every)
    return np.array(list(unique))
