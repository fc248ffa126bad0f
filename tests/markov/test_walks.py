import numpy as np

from jaxcell.mapping import Chain
from jaxcell.markov import sample_walks


def test_walks_follow_the_chain():
    matrix = np.array([[0.0, 0.25, 0.75], [1.0, 0.0, 0.0], [0.5, 0.5, 0.0]])
    starts = np.array([0, 1] * 50)
    walks = sample_walks(Chain.from_scipy(matrix), starts, 200, np.random.default_rng(0))
    assert walks.shape == (201, 100)
    np.testing.assert_array_equal(walks[0], starts)
    steps = np.zeros((3, 3))
    np.add.at(steps, (walks[:-1].ravel(), walks[1:].ravel()), 1)
    # The standard error of a share of some 6,000 steps is below 0.007.
    np.testing.assert_allclose(steps / steps.sum(axis=1, keepdims=True), matrix, atol=0.03)
    assert (steps[matrix == 0] == 0).all()


def test_walks_are_reproducible_from_their_seed():
    chain = Chain.from_scipy(np.full((4, 4), 0.25))
    first, again, other = (
        sample_walks(chain, np.zeros(3, int), 20, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
