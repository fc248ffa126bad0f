import inspect
import itertools

import hypothesis.strategies as st
import numpy as np
import pytest
from automata.fa.dfa import DFA
from hypothesis import given

from jaxcell.automata import equivalence
from jaxcell.automata.adaptive import levels


@st.composite
def machines(draw, most=8):
    states, inputs = draw(st.integers(1, most)), draw(st.integers(1, 3))
    images = st.lists(st.integers(0, states - 1), min_size=states, max_size=states)
    # Few observations are 1, so that states are hard to distinguish.
    seen = st.lists(st.sampled_from([0, 0, 0, 1]), min_size=states, max_size=states)
    several = {"min_size": inputs, "max_size": inputs}
    alike = seen.map(lambda row: [row] * inputs)
    observations = draw(alike | st.lists(seen, **several))
    return np.array(draw(st.lists(images, **several))), np.array(observations)


def answers(images, observations, state, word):
    seen = []
    for i in word:
        seen.append(observations[i, state])
        state = images[i, state]
    return seen


@given(machines(most=5))
def test_classes_and_levels_are_those_of_all_sequences(machine):
    inputs, states = machine[0].shape
    label = equivalence(*machine)
    assert label[0] == 0
    # Any two of 5 states that inputs distinguish are distinguished by 4 inputs.
    words = [w for n in range(states) for w in itertools.product(range(inputs), repeat=n)]
    for a, b in itertools.combinations(range(states), 2):
        telling = (len(w) for w in words if answers(*machine, a, w) != answers(*machine, b, w))
        shortest = next(telling, None)
        assert (label[a] != label[b]) == (shortest is not None)
        differ = (i for i, level in enumerate(levels(*machine)) if level[a] != level[b])
        assert next(differ, None) == shortest


@given(machines(most=30))
def test_number_of_classes_equals_automata_lib(machine):
    images, observations = machine
    # A letter of the start leads to each state. Each state accepts letters for its observations.
    transitions = {"end": {}, "start": {f"to {s}": s for s in range(images.shape[1])}}
    for state in range(images.shape[1]):
        transitions[state] = {f"go {i}": int(row[state]) for i, row in enumerate(images)}
        transitions[state] |= {f"see {i}": "end" for i, o in enumerate(observations) if o[state]}
        transitions[state]["live"] = "end"
    dfa = DFA(
        states=set(transitions),
        input_symbols={letter for row in transitions.values() for letter in row},
        transitions=transitions,
        initial_state="start",
        final_states={"end"},
        allow_partial=True,
    )
    assert np.unique(equivalence(images, observations)).size == len(dfa.minify().states) - 2


@given(machines(most=40))
def test_images_of_a_class_are_in_one_class(machine):
    label = equivalence(*machine)
    firsts = np.unique(label, return_index=True)[1]
    assert (np.diff(firsts) > 0).all()
    for image, observation in zip(*machine, strict=True):
        np.testing.assert_array_equal(label[image], label[image][firsts][label])
        np.testing.assert_array_equal(observation, observation[firsts][label])


def test_cells_of_a_long_corridor_differ_by_their_distance_to_its_end():
    squares = 20_000
    cell = np.arange(2 * squares)
    east = cell < squares
    bumped = (cell == squares - 1) | (cell == squares)
    image = np.where(bumped, (cell + squares) % cell.size, np.where(east, cell + 1, cell - 1))
    assert np.unique(equivalence(image[None], bumped[None])).size == squares


def test_states_of_a_combination_lock_differ_by_the_digits_that_open_it():
    # The digits are 0, 1, 0, 1, ...; a wrong digit leads to a state from which none opens it.
    digits = 400
    state = np.arange(digits + 2)
    right, lost = np.minimum(state + 1, digits), digits + 1
    images = np.stack([np.where(state % 2 == i, right, lost) for i in (0, 1)])
    images[:, -2:] = lost
    observations = np.broadcast_to(state == digits, images.shape)
    assert np.unique(equivalence(images, observations)).size == digits + 2


def test_bad_machines_are_refused():
    with pytest.raises(ValueError, match=r"images\[0, 1\] is 2; expected a state from 0 to 1"):
        equivalence(np.array([[0, 2]]), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="expected at least one input and state"):
        equivalence(np.zeros((0, 3), int), np.zeros((0, 3)))
    # The run-time type checks would refuse it first.
    with pytest.raises(ValueError, match=r"observations: expected .* \(2, 2\), got \(2,\)"):
        inspect.unwrap(equivalence)(np.array([[1, 0], [0, 1]]), np.array([True, False]))
