"""Small chains for tests, random and known."""

import numpy as np
import scipy.sparse
from hypothesis import strategies as st

from jaxcell.mapping.generalized import Chain


def complete(cells):
    """Return the matrix of steps to any other cell with equal probability."""
    return (1 - np.eye(cells)) / (cells - 1)


def birth_and_death(up, down):
    """Return the matrix of steps up or down a line; cells stay with the rest of the probability."""
    steps = np.diag(up, 1) + np.diag(down, -1)
    return steps + np.diag(1 - steps.sum(axis=1))


def open_line(cells):
    """Return the matrix of an even random walk on a line that it leaves at both ends."""
    return np.diag(np.full(cells - 1, 0.5), 1) + np.diag(np.full(cells - 1, 0.5), -1)


def steps_on_open_line(cells):
    """Return the expected number of steps until the walk has left the line, from each cell."""
    return np.arange(1, cells + 1) * np.arange(cells, 0, -1)


def random_chain(cells, seed):
    """Draw a chain whose rows are dominated by a few large probabilities."""
    return Chain.from_scipy(np.random.default_rng(seed).dirichlet(np.full(cells, 0.4), cells))


def tide(seed, phases=4, cells=30):
    """Draw a chain over the cells at each phase; some cells leave, and one skips a phase."""
    random = np.random.default_rng(seed)
    matrix = np.zeros((phases * cells, phases * cells))
    for k in range(phases):
        later = (k + 1) % phases * cells
        for i in range(cells):
            near = (i + random.integers(-1, 2, 2)) % cells
            np.add.at(matrix[k * cells + i], later + near, random.dirichlet([1, 1]))
    matrix[0, : 3 * cells] = np.roll(matrix[0], cells)[: 3 * cells]
    matrix[::7] *= 0.9
    return scipy.sparse.csr_array(matrix)


def dense_solution(matrix, right, adjoint=False):
    """Solve `x = right + matrix x`, or with the transposed matrix."""
    dense = scipy.sparse.csr_array(matrix).toarray()
    return np.linalg.solve(np.eye(len(dense)) - (dense.T if adjoint else dense), right)


@st.composite
def matrices(draw):
    """Draw a transition matrix with few edges, whose rows may sum to less than 1."""
    # There are few sizes, because JAX compiles once per size.
    cells = draw(st.sampled_from([6, 6, 1]))
    return drawn_rows(draw, cells, cells)


def drawn_rows(draw, rows, cells):
    """Draw rows of a transition matrix, each of one to three images or the sink."""
    matrix = np.zeros((rows, cells))
    for row in matrix:
        images = draw(st.lists(st.integers(0, cells), min_size=1, max_size=3))
        for image in images:
            # The image past the last cell is the sink.
            if image < cells:
                row[image] += 1 / len(images)
    return matrix


def with_sink(matrix):
    """Return the matrix with the sink as one more cell."""
    whole = np.pad(matrix, (0, 1))
    whole[:, -1] = 1 - whole.sum(axis=1)
    return whole


def arrival_law(matrix, start, there, steps):
    """Compute the law of the first arrival from powers of the matrix without the target."""
    among, into = matrix[~there][:, ~there], matrix[~there][:, there].sum(axis=1)
    powers = (np.linalg.matrix_power(among, time) for time in range(steps))
    return np.array([start[there].sum(), *(start[~there] @ power @ into for power in powers)])


def reachable(matrix):
    """Return a mask of the cells that each cell reaches, in 0 steps or more."""
    reach = np.eye(len(matrix), dtype=bool)
    for _ in matrix:
        reach |= (reach.astype(int) @ (matrix > 0).astype(int)) > 0
    return reach
