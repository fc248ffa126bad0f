"""Public functions that run on the host say so where JAX traces their arrays."""

import dataclasses
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import automata, bounce, examples, mapping, markov, optimize, patrol, space
from jaxcell.base.wide import wide


P = jnp.array([[0.5, 0.5], [0.25, 0.75]])


def chain(matrix):
    return mapping.Chain(jnp.array([[0, 0], [1, 1]]), matrix.T)


MAP = examples.patrol()
(POLICY,) = patrol.distributed_policies(*MAP, 1)
EDGE, TRIANGLE = (patrol.Graph(edges) for edges in ([[0, 1]], [[0, 1], [1, 2], [2, 0]]))


def vulnerability(share):
    walk = mapping.Chain(POLICY.chain.image, POLICY.chain.probability * share)
    policies = [dataclasses.replace(POLICY, chain=walk)]
    return patrol.vulnerability(jax.random.key(0), *MAP, policies, 0, patrol.Attack(2), runs=10)


CALLS = {
    "jaxcell.markov.almost_invariant_sets": lambda matrix: markov.almost_invariant_sets(
        chain(matrix), 1
    ),
    "Chain.to_scipy": lambda matrix: chain(matrix).to_scipy(),
    "jaxcell.mapping.transient_groups": lambda matrix: mapping.transient_groups(
        chain(matrix), mapping.persistent_groups(chain(P))
    ),
    "jaxcell.automata.equivalence": lambda matrix: automata.equivalence(
        (matrix > 0.3).astype(int), np.zeros((2, 2))
    ),
    "jaxcell.space.visible_cells": lambda matrix: space.visible_cells(
        examples.corridor(), matrix[0, 0]
    ),
    "jaxcell.markov.sample_walks": lambda matrix: markov.sample_walks(
        chain(matrix), np.array([0]), 3, np.random.default_rng(0)
    ),
    "jaxcell.optimize.stackelberg": lambda matrix: optimize.stackelberg(matrix, -matrix),
    "jaxcell.optimize.minimum_commute": lambda matrix: optimize.minimum_commute(
        TRIANGLE, durations=jnp.append(matrix[0], 1.0)
    ),
    "jaxcell.optimize.fastest_mixing": lambda matrix: optimize.fastest_mixing(
        EDGE, stationary=matrix[0]
    ),
    "jaxcell.patrol.law.fit_gld": lambda matrix: patrol.fit_gld(matrix[0]),
    "jaxcell.patrol.map.vulnerability": lambda matrix: vulnerability(matrix[0, 0]),
    "jaxcell.patrol.walks.maximin_capture": lambda matrix: patrol.maximin_capture(EDGE, matrix[0]),
    "jaxcell.patrol.walks.minimum_kemeny": lambda matrix: patrol.walks.minimum_kemeny(
        EDGE, stationary=matrix[0]
    ),
    "jaxcell.bounce.plan": lambda matrix: bounce.plan(
        examples.corridor(directions=4), start=0, goal=1, bounces=matrix[0]
    ),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, jax.grad])
def test_a_sentence_names_the_function(name, transform):
    if transform is jax.grad and name.startswith(("jaxcell.automata", "jaxcell.space")):
        pytest.skip("grad does not trace comparisons")
    call, given = transform(CALLS[name]), P[None] if transform is jax.vmap else P
    with pytest.raises(
        TypeError, match=r"on the host: call it outside jit, vmap and grad"
    ) as raised:
        call(given)
    assert str(raised.value).startswith(f"{name} ")


METHODS = {
    "Chain.can_leave": lambda matrix: chain(matrix).can_leave,
    "ChainSequence.of": lambda matrix: mapping.ChainSequence.of([chain(matrix)]),
}


@pytest.mark.parametrize("name", METHODS)
def test_a_sentence_names_the_method(name):
    with pytest.raises(TypeError, match=rf"^{name} reads .* on the host: call it outside jit"):
        jax.jit(METHODS[name])(P)


def test_errors_in_a_function_of_the_users_own_stay_what_they_are():
    def apply(function, given):
        return jax.jit(function)(given)

    hosted = wide(apply, "apply")
    with pytest.raises(jax.errors.TracerBoolConversionError):
        hosted(lambda x: x if x else -x, 1.0)


def test_functions_are_pickled_by_name():
    for function in (markov.kemeny_constant, mapping.persistent_groups, automata.equivalence):
        assert pickle.loads(pickle.dumps(function)) is function


def test_a_motion_refuses_a_traced_step():
    with pytest.raises(TypeError, match=r"step: expected a number, .* on the host"):
        jax.jit(space.Motion)(1.5)
