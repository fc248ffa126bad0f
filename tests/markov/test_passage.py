import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import arrival_law, complete, matrices

from jaxcell.mapping.generalized import Chain
from jaxcell.markov.passage import first_passage, survivals


STEPS = 12


def surviving_from_each_start(chain, there, steps):
    return np.asarray(survivals(chain, there, np.where(there, 0.0, 1.0), steps + 1)[0])


@given(matrices(), st.data())
def test_law_equals_powers_of_the_matrix(matrix, data):
    cells = len(matrix)
    target = sorted(data.draw(st.sets(st.integers(0, cells - 1), min_size=1)))
    there = np.isin(np.arange(cells), target)
    start = np.random.default_rng(data.draw(st.integers(0, 99))).dirichlet(np.ones(cells))
    chain = Chain.from_scipy(matrix)
    result = np.asarray(first_passage(chain, start, target, STEPS))
    np.testing.assert_allclose(result, arrival_law(matrix, start, there, STEPS), atol=1e-14)
    # The mass that has arrived and the mass that survives sum to 1, from each start.
    surviving = surviving_from_each_start(chain, there, STEPS)
    np.testing.assert_allclose(np.cumsum(result) + surviving @ start, 1, rtol=1e-12)
    for cell in range(cells):
        law = arrival_law(matrix, np.eye(cells)[cell], there, STEPS)
        np.testing.assert_allclose(surviving[:, cell], 1 - np.cumsum(law), atol=1e-12)


def test_law_on_a_complete_graph_is_geometric():
    n = 10
    chain = Chain.from_scipy(complete(n))
    time = np.arange(1, 31)
    expected = (1 - 1 / (n - 1)) ** (time - 1) / (n - 1)
    np.testing.assert_allclose(first_passage(chain, 3, 0, 30), [0, *expected], rtol=1e-13)
    # The tail keeps its relative accuracy.
    late = surviving_from_each_start(chain, np.arange(n) == 0, 400)[-1, 3]
    np.testing.assert_allclose(late, (8 / 9) ** 400, rtol=1e-12)


@pytest.mark.parametrize(
    "start", [[1, 3], np.array([3, 1, 3]), np.arange(4) % 2 == 1, [0.0, 0.5, 0.0, 0.5]]
)
def test_start_may_be_a_cell_a_list_a_mask_or_a_distribution(start):
    chain = Chain(np.array([[1, 2, 3, 0]]), np.ones((1, 4)))
    assert first_passage(chain, start, 0, 3).tolist() == [0, 0.5, 0, 0.5]


@pytest.mark.parametrize(
    ("start", "target", "steps", "message"),
    [
        (4, 0, 1, "start: cell 4 does not exist; cells are 0 to 3"),
        (np.ones(3) / 3, 0, 1, r"start: expected 4 probabilities, got shape \(3,\)"),
        (np.ones(4), 0, 1, "sum to 1, got the least 1.0 and the sum 4.0"),
        (np.array([1.5, -0.5, 0, 0]), 0, 1, "got the least -0.5"),
        (np.full(4, np.nan), 0, 1, "got the least nan"),
        (0, 1, -1, "steps: expected 0 or more, got -1"),
    ],
)
def test_bad_input_is_refused(start, target, steps, message):
    chain = Chain(np.array([[1, 2, 3, 0]]), np.ones((1, 4)))
    with pytest.raises(ValueError, match=message):
        first_passage(chain, start, target, steps)
