"""The lines of a grid: every square on one of them, in the order of steps."""

import numpy as np
from hypothesis import given, strategies as st

from jaxcell.space import line_orders, stencils
from jaxcell.space.stencils import GridLines


SIZES = st.integers(1, 7)
STEPS = st.tuples(st.integers(-8, 8), st.integers(-8, 8)).filter(any)


def walked(rows, columns, step):
    """The squares, by walking each line from a square that no step leads to."""
    squares = {(row, column) for row in range(rows) for column in range(columns)}
    found = []
    for row, column in sorted(squares):
        if (row - step[0], column - step[1]) in squares:
            continue
        while (row, column) in squares:
            found.append(row * columns + column)
            row, column = row + step[0], column + step[1]
    return found


@given(SIZES, SIZES, STEPS)
def test_squares_are_in_the_order_of_steps(rows, columns, step):
    assert line_orders(rows, columns, (step,)).tolist() == [walked(rows, columns, step)]


@given(SIZES, SIZES, STEPS)
def test_places_are_those_in_the_order(rows, columns, step):
    lines = GridLines.of(rows, columns, step)
    assert lines.place(lines.order()).tolist() == list(range(rows * columns))


@given(SIZES, SIZES, STEPS, st.integers(1, 9))
def test_parts_are_whole_lines(rows, columns, step, size):
    lines = GridLines.of(rows, columns, step)
    whole, stencils.SQUARES_AT_ONCE = stencils.SQUARES_AT_ONCE, size
    try:
        parts = list(lines.parts())
    finally:
        stencils.SQUARES_AT_ONCE = whole
    np.testing.assert_array_equal(np.concatenate(parts), lines.order())
    assert {part[0] for part in parts} <= set(lines.first.tolist())
    assert max(map(len, parts)) <= max(size, np.diff(lines.start).max()) + size
