"""Public entrances of chains and cell maps, called as by users, with wrong arguments."""

import json
import re
import subprocess
import sys

import pytest


REFUSED = """
TIDE.push(np.ones(3), -1)
Chain.from_scipy(GRAPH)
Chain.from_scipy(5)
Chain.from_scipy("abc")
Chain.from_scipy(None)
Chain.from_scipy([])
Chain.from_scipy(np.zeros((0, 0)))
Chain.from_scipy(np.zeros(3))
Chain.from_scipy(np.ones((2, 2, 2)))
Chain.from_scipy(np.eye(2, dtype=object))
Chain.from_scipy(np.eye(2, dtype=np.longdouble))
Chain.from_scipy(np.eye(2, dtype=np.float16))
Chain(5, 5)
Chain([[1, 2, 0]], [[1, 1, 1]])
Chain([[1, 2], [0]], np.ones((1, 3)))
CHAIN.push("abc")
CHAIN.pull(None)
TIDE.push(np.ones(3), 1.5)
TIDE.push(np.ones(2), 1)
TIDE.pull(np.ones(3), -1)
TIDE.pull(np.ones(3), 1.5)
TIDE.pull(np.ones(2), 1)
TIDE.at(1.5)
TIDE.at("a")
list(TIDE.pushed(np.ones(3), -1))
list(TIDE.pushed(np.ones(3), 1.5))
list(TIDE.pushed(np.ones(2), 1))
ChainSequence.of([])
ChainSequence.of(RING)
ChainSequence.of([RING, 5])
ChainSequence(5, 5)
SimpleMap(5, 5)
SimpleMap(np.array([1, 0]), None)
SimpleMap(np.array([1.0, 0]), np.array([True, False]))
SimpleMap(np.array([1, 2 ** 40]), np.array([True, False]))
periodic_groups(5)
periodic_groups(None)
periodic_groups("abc")
periodic_groups([1, 2 ** 40])
periodic_groups([[1, 0], [1]])
periodic_groups(RING)
periodic_groups(np.array([1, 0], object))
persistent_groups(5)
persistent_groups("rows")
persistent_groups(None)
transient_groups("rows", GROUPS)
transient_groups(CHAIN, None)
transient_groups(CHAIN, 5)
transient_groups(TIDE, GROUPS)
section_cycles(5)
section_cycles(Section(np.array([1, 0]), np.ones(3, int), np.zeros(2, int), np.ones(2, bool)))
section_cycles(Section(np.array([1, 0]), np.ones(2), np.zeros(2, int), np.ones(2, bool)))
hitting_times(CHAIN, [])
hitting_times(CHAIN, "a")
hitting_times(CHAIN, None)
hitting_times(CHAIN, 2 ** 40)
hitting_times(CHAIN, np.array([True, False]))
hitting_times(CHAIN, np.nan)
hitting_times(CHAIN, {1})
hitting_times(TIDE, 1)
hitting_times(CHAIN, True)
conditional_hitting_times(TIDE, 0)
absorption_times(TIDE, GROUPS)
absorption_probabilities(CHAIN, 5)
limiting_distribution(CHAIN, GROUPS, weights="x")
limiting_distribution(CHAIN, GROUPS, weights=[2])
limiting_distribution(CHAIN, GROUPS, weights=[np.nan])
limiting_distribution(CHAIN, GROUPS, weights=[[1.0]])
limiting_distribution(CHAIN, GROUPS, weights=["a"])
limiting_distribution(CHAIN, GROUPS, weights=5)
first_passage(CHAIN, 0, 2, -1)
first_passage(CHAIN, 0, 2, 1.5)
first_passage(CHAIN, 0, 2, np.nan)
first_passage(CHAIN, 0, 2, "a")
first_passage(CHAIN, 0, 2, None)
first_passage(CHAIN, np.array([np.nan, 0, 0.0]), 2, 3)
first_passage(CHAIN, "a", 2, 3)
first_arrival(CHAIN, [0], 2, 3)
first_arrival([CHAIN], 0, 2, 3)
first_arrival(["rows"], [0], 2, 3)
first_arrival([CHAIN], [0], 2, 1.5)
first_arrival([CHAIN], [None], 2, 1)
first_arrival([CHAIN], Distinct(5), 2, 1)
first_arrival([CHAIN], None, 2, 1)
mean_first_arrival([CHAIN], [0], 2, tolerance=np.nan)
mean_first_arrival([CHAIN], [0], 2, tolerance="a")
mean_first_arrival([CHAIN], [0], 2, max_steps=-1)
mean_first_arrival([CHAIN], [0], 2, max_steps=1.5)
mean_first_arrival([CHAIN], [0], 2, max_steps="a")
simulate_arrival(jax.random.key(0), [CHAIN], [0], 2, runs=1)
simulate_arrival(jax.random.key(0), [CHAIN], [0], 2, runs=2.5)
simulate_arrival(jax.random.key(0), [CHAIN], [0], 2, runs=2, horizon=1.5)
simulate_arrival(jax.random.key(0), [CHAIN], [0], 2, runs=2, horizon=-1)
simulate_arrival(jax.random.key(0), [CHAIN], [0], 2, runs="a")
sample_walks(RING, np.array([0]), 1.5, DRAW)
sample_walks(RING, np.array([0]), 1, 5)
sample_walks(RING, np.array([0]), 1, None)
sample_walks("rows", np.array([0]), 1, DRAW)
sample_walks(RING, np.array([0]), None, DRAW)
leading_modes(CHAIN, 1, start=-1)
leading_modes(CHAIN, 1, start=1.5)
leading_modes(CHAIN, 1, steps=1.5)
leading_modes(CHAIN, 1, steps=0)
leading_modes(CHAIN, 1, steps="a")
leading_modes(CHAIN, 1.5)
leading_modes(CHAIN, 0)
leading_modes(CHAIN, "a")
leading_modes(CHAIN, None)
almost_invariant_sets(CHAIN, 1, start=-1)
almost_invariant_sets(CHAIN, 1.5)
almost_invariant_sets(CHAIN, 1, mass="a")
almost_invariant_sets(CHAIN, 1, mass=[1, np.nan, 1])
almost_invariant_sets(CHAIN, 1, mass=[])
almost_invariant_sets(CHAIN, 1, blur="rows")
coherent_sets(CHAIN, None)
attracting_regions(CHAIN, 1, steps=1.5)
attracting_regions(CHAIN, 1, mass=5)
hitting_matrix(CHAIN)
mixing_time(RING, np.nan)
mixing_time(RING, "a")
value_iteration(MODEL, np.nan)
value_iteration(MODEL, "a")
value_iteration(MODEL, 0.5, tolerance="a")
value_iteration(MODEL, 0.5, tolerance=np.nan)
value_iteration(MODEL, 0.5, max_rounds=1.5)
value_iteration(MODEL, 0.5, max_rounds="a")
value_iteration(RING, 0.5)
policy_chain(MODEL, None)
policy_chain(MODEL, "a")
policy_chain(RING, np.array([0, 1, 0]))
stochastic_shortest_path(MODEL, None)
stochastic_shortest_path(RING, 0)
DecisionModel.of([RING], "a")
DecisionModel.of([RING], [["a", "b", "c"]])
DecisionModel.of([RING], np.zeros((1, 3)), allowed=[[1, 1, 1]])
DecisionModel.of(RING, np.zeros((1, 3)))
DecisionModel.of(["rows"], np.zeros((1, 3)))
markov.dense.stationary(np.ones((2, 3)))
markov.dense.stationary("a")
markov.dense.hitting(np.ones(3))
markov.dense.kemeny(None)
simulate_arrival(5, [CHAIN], [0], 2, runs=2)
periodic_groups(GRAPH)
Chain.from_scipy(-ROWS)
Chain.from_scipy(ROWS * np.nan)
Chain.from_scipy(ROWS * 1j)
TIDE.pushed(np.ones(3), -1).__next__()
mixing_time(RING, -1)
value_iteration(MODEL, 1)
first_arrival([CHAIN], [0], 2, -1)
DecisionModel.of([RING], np.full((1, 3), np.nan))
Chain(np.array([[1, 2, 2 ** 40]]), np.ones((1, 3)))
"""
# Calls with the message that names the place and the value.
NAMED = {
    "periodic_groups([0, 5])": r"image\[1\]: cell 5 does not exist; cells are 0 to 1",
    "periodic_groups([0, -1])": r"image\[1\]: cell -1 does not .*; give a sink a cell",
    "periodic_groups(jnp.array([2, 0]))": r"image\[0\]: cell 2 does not exist",
    "periodic_groups([0.0, 1.0])": "image: expected whole numbers of cells, got float",
    "periodic_groups([True, False])": "image: expected whole numbers of cells, got bool",
    "periodic_groups([[0, 1]])": r"image: .* each cell, got shape \(1, 2\)",
    "SimpleMap(np.array([0, 2]), np.zeros(2, bool))": r"image\[1\]: cell 2 does not exist",
    "SimpleMap(np.array([0, 1]), np.zeros(3, bool))": r"bumped: expected a mask of shape \[2\]",
    "section_cycles(Section(np.array([0, 2]), ONE, ONE, ONE == 1))": r"successor\[1\]: slot 2 does",
    "ChainSequence(np.array([[[0, 2]]]), np.ones((1, 1, 2)))": r"image\[0, 0, 1\]: cell 2 does not",
    "ChainSequence(np.array([[[0, 1]]]), np.full((1, 1, 2), 2.0))": "cell 0 sum to 2.0; ",
    "Chain.from_scipy(np.eye(2, dtype=np.float16))": "expected float64, got float16; convert it",
    "RING.push(jnp.ones(1))": r"distribution: .* each of 3 cells, got \[1\]",
    "RING.pull(jnp.ones((3, 3)))": r"value: .* each of 3 cells, got \[3, 3\]",
    "sample_walks(RING, np.array([3]), 2, DRAW)": r"starts\[0\]: cell 3 does not exist",
    "sample_walks(RING, np.array([0.5]), 2, DRAW)": "starts: expected whole numbers",
    "sample_walks(RING, np.array([0]), -1, DRAW)": "steps: expected 0 or more, got -1",
    "policy_chain(MODEL, np.array([0, 1]))": r"policy: .* for each of 3 cells, got \[2\]",
    "policy_chain(MODEL, np.array([0, 1, 1.0]))": "policy: expected whole numbers",
    "policy_chain(MODEL, np.array([0, 2, 1]))": r"policy\[1\]: action 2 does not exist",
    "first_passage(RING, -1, 0, 3)": "start: cell -1 does not exist; cells are 0 to 2",
    "hitting_times(RING, [0, 3])": r"target\[1\]: cell 3 does not exist",
    "hitting_times(RING, 1.0)": "target: expected whole numbers of cells, got float64",
}
# Calls with numbers in another form, and the same calls in the usual form.
EQUAL = {
    'Chain.from_scipy(ROWS.astype(">f8"))': "CHAIN",
    "Chain.from_scipy(ROWS.tolist())": "CHAIN",
    "Chain.from_scipy(sp.coo_matrix(ROWS))": "CHAIN",
    "Chain.from_scipy(sp.csr_array(ROWS))": "CHAIN",
    "Chain.from_scipy(sp.lil_array(ROWS))": "CHAIN",
    "Chain([[1, 2, 0]], [[1.0, 1, 1]])": "RING",
    'Chain(BIG, np.ones((1, 3), ">f8"))': "RING",
    'ChainSequence(BIG[None], np.ones((1, 1, 3), ">f8"))': "ChainSequence.of([RING])",
    'CHAIN.push(np.ones(3, ">f8"))': "CHAIN.push(np.ones(3))",
    "CHAIN.push([1, 0, 0])": "CHAIN.push(np.array([1.0, 0, 0]))",
    'CHAIN.pull(np.ones(3, ">f8"))': "CHAIN.pull(np.ones(3))",
    "TIDE.push([1, 0, 0], 1)": "TIDE.push(np.array([1.0, 0, 0]), 1)",
    'TIDE.push(np.ones(3, ">f8"), 1)': "TIDE.push(np.ones(3), 1)",
    'TIDE.pull(np.ones(3, ">f8"), 1)': "TIDE.pull(np.ones(3), 1)",
    "SimpleMap([1, 0], [True, False])": "SimpleMap(np.array([1, 0]), np.array([True, False]))",
    "SimpleMap(BIG[0], np.ones(3, bool)).image.tolist()": "[1, 2, 0]",
    "periodic_groups([]).count.tolist()": "0",
    "periodic_groups(BIG[0]).period.tolist()": "[3, 3, 3]",
    "section_cycles(Section([1, 0], [1, 1], [0, 0], [True, True])).period.tolist()": "[2, 0]",
    "section_cycles(Section(*[BIG[0]] * 3, np.ones(3, bool))).leader.tolist()": "[0, 0, 0]",
    'hitting_times(CHAIN, np.array([2], ">i8")).value': "hitting_times(CHAIN, 2).value",
    'first_passage(CHAIN, np.array([1, 0, 0.0], ">f8"), 2, 3)': "first_passage(CHAIN, 0, 2, 3)",
    'policy_chain(MODEL, np.array([0, 1, 0], ">i4"))': "RING",
    'DecisionModel.of([RING], np.ones((1, 3), ">f8")).reward.tolist()': "[[1.0, 1.0, 1.0]]",
    'dense.stationary(ROWS.astype(">f8"))': "dense.stationary(ROWS)",
    "dense.stationary(np.array([[0, 1], [1, 0]])).tolist()": "[0.5, 0.5]",
}
# No test framework checks types in this process.
SCRIPT = """
import json, sys, jax, jax.numpy as jnp, networkx, numpy as np, scipy.sparse as sp, warnings
from jaxcell import mapping, markov
from jaxcell.mapping import *
from jaxcell.markov import *
warnings.simplefilter("error")
ROWS = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 1]])
CHAIN, DRAW, BIG = Chain.from_scipy(ROWS), np.random.default_rng(0), np.array([[1, 2, 0]], ">i4")
RING, ONE = Chain(np.array([[1, 2, 0]]), np.ones((1, 3))), np.ones(2, int)
TIDE, MODEL = ChainSequence.of([RING, RING]), DecisionModel.of([RING, RING], np.zeros((2, 3)))
GROUPS, GRAPH = persistent_groups(CHAIN), networkx.DiGraph([(0, 1), (1, 0)])
answers = {}
for call in json.loads(sys.argv[1]):
    try:
        value = eval(call)
        answers[call] = str([np.asarray(leaf).tolist() for leaf in jax.tree.leaves(value)])
    except Exception as error:
        answers[call] = f"{type(error).__name__}: {error}"
print(json.dumps(answers))
"""


# Functions of a chain alone, or of a chain and a cell or a number.
ALONE = """hitting_matrix commute_times kemeny_constant entropy_rate slem mixing_time
absorption_times absorption_probabilities limiting_distribution"""
WITH_NUMBER = """hitting_times arrival_probabilities conditional_hitting_times leading_modes
almost_invariant_sets coherent_sets attracting_regions"""
TAKES_CHAIN = [
    *(f"{name}('rows')" for name in ALONE.split()),
    *(f"{name}('rows', 1)" for name in WITH_NUMBER.split()),
]


@pytest.fixture(scope="module")
def answers():
    calls = [*REFUSED.split("\n")[1:-1], *TAKES_CHAIN, *NAMED, *EQUAL, *EQUAL.values()]
    command = [sys.executable, "-c", SCRIPT, json.dumps(calls)]
    return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)


@pytest.mark.parametrize("call", REFUSED.split("\n")[1:-1])
def test_wrong_arguments_are_refused_in_a_line_that_says_what_is_expected(call, answers):
    kind, _, message = answers[call].partition(": ")
    assert kind == "ValueError", answers[call]
    assert "\n" not in message
    assert "expected" in message or "does not exist" in message


@pytest.mark.parametrize("call", TAKES_CHAIN)
def test_a_text_is_no_chain(call, answers):
    assert re.match(
        r"ValueError: (\w+: )?chain: expected a Chain( or ChainSequence)?, got str", answers[call]
    )


@pytest.mark.parametrize("call", NAMED)
def test_errors_name_the_place_and_the_value(call, answers):
    assert re.match("ValueError: .*" + NAMED[call], answers[call])


@pytest.mark.parametrize("call", EQUAL)
def test_numbers_in_another_form_are_the_same_numbers(call, answers):
    assert answers[call] == answers[EQUAL[call]]
    assert "Error" not in answers[call]
