"""Walks and groups of other chains, rounded numbers, and whole numbers as probabilities."""

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import python

from jaxcell import mapping, markov
from jaxcell.mapping import Chain


RING = Chain(np.array([[1, 2, 0]]), np.ones((1, 3)))


def test_walks_that_may_leave_the_space_are_refused():
    leaving = Chain.from_scipy(np.array([[0.5, 0.5], [0.0, 0.5]]))
    with pytest.raises(ValueError, match="one that never leaves the space, as cell 1 may"):
        markov.sample_walks(leaving, np.array([0]), 2, np.random.default_rng(0))


def test_traced_indices_are_checked_for_their_kind_only():
    assert jax.jit(lambda image: mapping.periodic_groups(image).count)(jnp.array([1, 0])) == 1
    with pytest.raises(ValueError, match="expected whole numbers of cells, got float64"):
        jax.jit(mapping.periodic_groups)(jnp.array([1.0, 0.0]))


@pytest.mark.parametrize(
    "function",
    [
        mapping.transient_groups,
        markov.absorption_times,
        markov.absorption_probabilities,
        markov.limiting_distribution,
    ],
)
def test_groups_of_another_chain_of_equal_size_are_refused(function):
    ends = Chain.from_scipy(np.array([[1, 0, 0], [0.5, 0, 0.5], [0, 0, 1]]))
    with pytest.raises(ValueError, match=r"those of another chain, which differ at cell 1"):
        function(ends, mapping.persistent_groups(RING))
    # Groups that were found for an equal chain are right.
    function(Chain(ends.image, ends.probability), mapping.persistent_groups(ends))


@pytest.mark.parametrize(
    ("rows", "warned"),
    [
        (np.full((3, 3), 0.333), 3),
        (np.full((3, 3), 0.3333333333), 3),
        # Rows that 32 bits rounded are divided by their sums.
        (np.array([[0.9, 0.1], [0.1, 0.9]], np.float32).astype(float), 0),
        # A row that truly leaves does not hide the others.
        ([[0.33333, 0.33333, 0.33333], [0.5, 0.4, 0], [0, 0, 1]], 1),
        ([[0.5, 0.25, 0], [0.5, 0.4, 0], [0, 0, 0.99]], 0),
    ],
)
def test_rows_of_rounded_numbers_are_counted(rows, warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mapping.Chain.from_scipy(np.asarray(rows))
    counts = [int(re.search(r"numbers of (\d+) of", str(one.message))[1]) for one in caught]
    assert counts == ([warned] if warned else [])


def test_whole_numbers_are_pushed_and_pulled_as_probabilities():
    """Without checks of types, as for users; truncated products would be 0."""
    program = (
        "import numpy as np; from jaxcell.mapping import Chain;"
        "chain = Chain.from_scipy(np.array([[.5, .5, 0], [0, .5, .5], [0, 0, 1]]));"
        "start = np.array([1, 0, 0]); print(*chain.push(start), *chain.pull(start))"
    )
    out, _ = python("-c", program)
    assert [float(number) for number in out.split()] == [0.5, 0.5, 0, 0.5, 0, 0]
