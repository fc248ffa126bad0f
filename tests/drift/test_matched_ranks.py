import numpy as np

from jaxcell.drift.matched_ranks import basin_ranks


def test_a_colour_is_of_one_place_in_all_layers():
    """Groups 0 and 1 of the top are 1 and 2 below, of other sizes; 0 is new there, and lasts."""
    top = np.array([[0, 0, 1, 1, 1, -1]])
    middle = np.array([[1, 1, 2, 2, -1, 0]])
    deep = np.array([[-1, 1, 0, -1, -1, 2]])
    found = basin_ranks([top, middle, deep])
    assert [rank.tolist() for rank in found] == [[1, 0], [2, 1, 0], [0, 1, 2]]
    # In the middle either of two groups could go on; all together have most in common.
    crossed = basin_ranks([np.array([[0] * 5 + [1] * 4]), np.array([[0] * 4 + [1, 0, 0, 0, 1]])])
    assert [rank.tolist() for rank in crossed] == [[0, 1], [0, 1]]
    none = basin_ranks([np.full((1, 6), -1), top])
    assert [rank.tolist() for rank in none] == [[], [1, 0]]
