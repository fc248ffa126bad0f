"""Small random decision models for property tests, and all their policies."""

import itertools

import numpy as np
from hypothesis import strategies as st
from random_chains import drawn_rows

from jaxcell.mapping.generalized import Chain
from jaxcell.markov.decision import DecisionModel


@st.composite
def models(draw):
    """Draw transition matrices `[actions, cells, cells]`, rewards, and allowed actions."""
    # There are few sizes, because JAX compiles once per size.
    cells = draw(st.sampled_from([4, 4, 1]))
    actions = draw(st.sampled_from([1, 3]))
    matrices = drawn_rows(draw, actions * cells, cells).reshape(actions, cells, cells)
    reward = np.array(draw(st.lists(st.integers(-9, 9), min_size=actions, max_size=actions * 5)))
    allowed = np.array([[draw(st.booleans()) for _ in range(cells)] for _ in range(actions)])
    allowed[0] |= ~allowed.any(axis=0)
    return matrices, np.resize(reward, (actions, cells)).astype(float), allowed


def as_model(matrices, reward, allowed):
    """Make a model whose chains all have three branches, so that few shapes are compiled."""
    chains = []
    for matrix in matrices:
        image = np.argsort(-matrix, axis=1)[:, :3]
        probability = np.take_along_axis(matrix, image, axis=1)
        chains.append(Chain(image.T, probability.T))
    return DecisionModel.of(chains, reward, allowed)


def policies(allowed):
    """Return all allowed policies, as arrays of actions."""
    choices = [np.flatnonzero(column) for column in allowed.T]
    return [np.array(policy) for policy in itertools.product(*choices)]
