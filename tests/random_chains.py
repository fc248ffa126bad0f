"""Small random chains for property tests."""

import numpy as np
from hypothesis import strategies as st


@st.composite
def matrices(draw):
    """Transition matrices with few edges, whose rows may sum to less than 1."""
    # Few sizes, since each is compiled once.
    cells = draw(st.sampled_from([6, 6, 1]))
    matrix = np.zeros((cells, cells))
    for row in matrix:
        images = draw(st.lists(st.integers(0, cells), min_size=1, max_size=3))
        for image in images:
            # The image past the last cell is the sink.
            if image < cells:
                row[image] += 1 / len(images)
    return matrix


def reachable(matrix):
    """Return a mask of the cells that each cell reaches, in 0 steps or more."""
    reach = np.eye(len(matrix), dtype=bool)
    for _ in matrix:
        reach |= (reach.astype(int) @ (matrix > 0).astype(int)) > 0
    return reach
