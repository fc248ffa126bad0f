"""The lines of a grid: every square on one of them, in the order of steps."""

import numpy as np
from hypothesis import given, strategies as st

from jaxcell.space.stencils import line_places


SIZES = st.integers(1, 7)
STEPS = st.tuples(st.integers(-8, 8), st.integers(-8, 8)).filter(any)


def walked(rows, columns, step):
    """The lines, by walking each from a square that no step leads to."""
    squares = {(row, column) for row in range(rows) for column in range(columns)}
    found = []
    for row, column in sorted(squares):
        if (row - step[0], column - step[1]) in squares:
            continue
        found.append([])
        while (row, column) in squares:
            found[-1].append(row * columns + column)
            row, column = row + step[0], column + step[1]
    return found


@given(SIZES, SIZES, STEPS)
def test_places_ascend_along_lines_and_lines_do_not_mix(rows, columns, step):
    size = rows * columns
    last = -1
    # Two grids, one after the other.
    for grid in range(2):
        for line in walked(rows, columns, step):
            squares = np.array(line) + grid * size
            places = line_places(squares, (rows, columns), step).tolist()
            assert places == list(range(places[0], places[0] + len(line)))
            assert last < places[0]
            last = places[-1]
