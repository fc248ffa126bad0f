"""Refusals of indices out of range, of arrays that do not fit, and of groups of another chain."""

import json
import re
import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import python

from jaxcell import mapping, markov
from jaxcell.mapping import Chain


CALLS = {
    "mapping.periodic_groups([0, 5])": r"image\[1\]: cell 5 does not exist; cells are 0 to 1",
    "mapping.periodic_groups([0, -1])": r"image\[1\]: cell -1 does not .*; give a sink a cell",
    "mapping.periodic_groups(jnp.array([2, 0]))": r"image\[0\]: cell 2 does not exist",
    "mapping.periodic_groups([0.0, 1.0])": "image: expected whole numbers of cells, got float",
    "mapping.periodic_groups([True, False])": "image: expected whole numbers of cells, got bool",
    "mapping.periodic_groups([[0, 1]])": r"image: .* each cell, got shape \(1, 2\)",
    "SimpleMap(np.array([0, 2]), np.zeros(2, bool))": r"image\[1\]: cell 2 does not exist",
    "SimpleMap(np.array([0, 1]), np.zeros(3, bool))": r"bumped: expected a mask of shape \[2\]",
    "section_cycles(Section(np.array([0, 2]), ONE, ONE, ONE == 1))": r"successor\[1\]: slot 2 does",
    "ChainSequence(np.array([[[0, 2]]]), np.ones((1, 1, 2)))": r"image\[0, 0, 1\]: cell 2 does not",
    "ChainSequence(np.array([[[0, 1]]]), np.full((1, 1, 2), 2.0))": "cell 0 sum to 2.0; ",
    "Chain.from_scipy(np.eye(2, dtype=bool))": "expected float64, got bool",
    "Chain.from_scipy(np.eye(2, dtype=np.float32))": "expected float64, got float32; convert it",
    "RING.push(jnp.ones(1))": r"distribution: .* each of 3 cells, got \[1\]",
    "RING.pull(jnp.ones((3, 3)))": r"value: .* each of 3 cells, got \[3, 3\]",
    "markov.sample_walks(RING, np.array([3]), 2, DRAW)": r"starts\[0\]: cell 3 does not exist",
    "markov.sample_walks(RING, np.array([0.5]), 2, DRAW)": "starts: expected whole numbers",
    "markov.sample_walks(RING, np.array([0]), -1, DRAW)": "steps: expected 0 or more, got -1",
    "markov.policy_chain(MODEL, np.array([0, 1]))": r"policy: .* for each of 3 cells, got \[2\]",
    "markov.policy_chain(MODEL, np.array([0, 1, 1.0]))": "policy: expected whole numbers",
    "markov.policy_chain(MODEL, np.array([0, 2, 1]))": r"policy\[1\]: action 2 does not exist",
    "markov.first_passage(RING, -1, 0, 3)": "start: cell -1 does not exist; cells are 0 to 2",
    "markov.hitting_times(RING, [0, 3])": r"target\[1\]: cell 3 does not exist",
    "markov.hitting_times(RING, 1.0)": "target: expected whole numbers of cells, got float64",
}

# The functions are called as by a user, whose arguments no test framework checks.
SCRIPT = """
import json, sys, jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from jaxcell import mapping, markov
from jaxcell.mapping import Chain, ChainSequence, Section, SimpleMap, section_cycles
ONE, DRAW = np.ones(2, int), np.random.default_rng(0)
RING = Chain(np.array([[1, 2, 0]]), np.ones((1, 3)))
MODEL = markov.DecisionModel.of([RING, RING], np.zeros((2, 3)))
answers = {}
for call in json.loads(sys.argv[1]):
    try:
        answers[call] = repr(eval(call))
    except ValueError as error:
        answers[call] = str(error)
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers():
    command = [sys.executable, "-c", SCRIPT, json.dumps(list(CALLS))]
    return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)


@pytest.mark.parametrize("call", CALLS)
def test_indices_out_of_range_and_wrong_arrays_are_refused(call, answers):
    assert re.match(".*" + CALLS[call], answers[call])


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
        (np.array([[0.9, 0.1], [0.1, 0.9]], np.float32).astype(float), 2),
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
