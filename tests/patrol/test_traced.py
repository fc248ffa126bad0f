"""Quantities of patrols under jit, vmap and grad, against exact rationals and closed forms."""

import dataclasses
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from graphs import incidence
from walks import missed, walk_on

from jaxcell import examples, patrol
from jaxcell.mapping import Chain
from jaxcell.optimize import Graph
from jaxcell.patrol import perimeter, team, walks
from jaxcell.patrol.map.circulation import shares
from jaxcell.patrol.walks.steps import Steps


KITE = Graph([[0, 1], [1, 2], [2, 0], [2, 3]])
WEIGHTS = np.array([1.0, 3.0, 2.0, 5.0])
TIMES = np.array([1, 3, 2, 1])
SMALL = Fraction(1, 10**8)


def rational_walk(weights):
    matrix = [[Fraction(0)] * 4 for _ in range(4)]
    for (tail, head), weight in zip(KITE.edges.tolist(), weights, strict=True):
        matrix[tail][head] = matrix[head][tail] = weight
    return [[p / sum(row) for p in row] for row in matrix]


def captured(matrix, times, start, goal, left):
    """The probability that a walk from a start visits a goal in the time left, over all walks."""
    lasts = {frozenset(edge): t for edge, t in zip(KITE.edges.tolist(), times, strict=True)}
    return sum(
        chance * (1 if there == goal else captured(matrix, times, there, goal, left - last))
        for there, chance in enumerate(matrix[start])
        if chance and (last := int(lasts[frozenset((start, there))])) <= left
    )


def difference(compute, at, edge):
    """The derivative of rational numbers by one of the rational arguments `at`."""
    ends = []
    for sign in (1, -1):
        moved = [Fraction(x) + sign * SMALL * (i == edge) for i, x in enumerate(at)]
        ends.append(np.array(compute(moved), dtype=object))
    return ((ends[0] - ends[1]) / (2 * SMALL)).astype(float)


@pytest.mark.parametrize("times", [None, TIMES])
def test_capture_by_a_walk_has_the_derivatives_of_rational_numbers(times):
    def of_weights(weights):
        matrix = walks.random_walk(KITE, weights)
        dense = jnp.zeros((4, 4)).at[jnp.arange(4)[None], matrix.image].add(matrix.probability)
        return walks.walk_capture_probabilities(KITE, dense, 5, times)

    def exact(weights):
        matrix = rational_walk(weights)
        given = np.ones(4, int) if times is None else times
        return [[captured(matrix, given, i, j, 5) for j in range(4)] for i in range(4)]

    found = jax.jit(jax.jacrev(of_weights))(jnp.asarray(WEIGHTS))
    for edge in range(4):
        expected = difference(exact, WEIGHTS, edge)
        np.testing.assert_allclose(found[..., edge], expected, rtol=1e-10, atol=1e-14)
    both = jax.vmap(of_weights)(jnp.stack([WEIGHTS, WEIGHTS[::-1]]))
    for one, weights in zip(both, (WEIGHTS, WEIGHTS[::-1]), strict=True):
        np.testing.assert_allclose(one, np.array(exact(map(Fraction, weights)), float), rtol=1e-13)


@pytest.mark.parametrize("how", ["solved", "long_run"])
def test_shares_of_time_have_the_derivatives_of_their_closed_form(how):
    """The share of a vertex is half of the weight of its edges, divided by that of all."""

    def found(weights):
        chain = walks.random_walk(KITE, weights)
        if how == "solved":
            return shares(chain.probability, 2, Steps.of(KITE))
        dense = jnp.zeros((4, 4)).at[jnp.arange(4)[None], chain.image].add(chain.probability)
        return team.long_run([dense])[0]

    ends, total = np.abs(incidence(KITE)), WEIGHTS.sum()
    np.testing.assert_allclose(found(jnp.asarray(WEIGHTS)), ends @ WEIGHTS / total / 2, rtol=1e-12)
    expected = (ends - (ends @ WEIGHTS / total)[:, None]) / total / 2
    slopes = jax.jit(jax.jacrev(found))(jnp.asarray(WEIGHTS))
    np.testing.assert_allclose(slopes, expected, rtol=1e-9, atol=1e-14)


def test_blind_capture_has_the_derivatives_of_rational_numbers():
    def found(weights):
        chain = walks.random_walk(KITE, weights)
        dense = jnp.zeros((4, 4)).at[jnp.arange(4)[None], chain.image].add(chain.probability)
        return walks.blind_capture(KITE, [dense], 3)

    def exact(weights):
        matrix, whole = rational_walk(weights), 2 * sum(weights)
        often = [
            sum(w for e, w in zip(KITE.edges, weights, strict=True) if i in e) for i in range(4)
        ]
        # An attack begins as the robot is on its way to its next vertex.
        return [
            sum(
                often[i] / whole * matrix[i][j] * (1 if j == goal else visit(matrix, j, goal, 2))
                for i in range(4)
                for j in range(4)
            )
            for goal in range(4)
        ]

    def visit(matrix, start, goal, left):
        return captured(matrix, np.ones(4, int), start, goal, left)

    slopes = jax.jit(jax.jacrev(found))(jnp.asarray(WEIGHTS))
    for edge in range(4):
        expected = difference(exact, WEIGHTS, edge)
        np.testing.assert_allclose(slopes[:, edge], expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("start", ["stationary", "uniform", "worst"])
def test_capture_on_a_map_has_the_derivatives_of_powers_of_a_matrix(start):
    graph, visible = examples.patrol()
    (policy,) = patrol.distributed_policies(graph, visible, 1)
    attack, weights = patrol.Attack([2, 5], start), np.array([1.0, 2.0, 3.0, 1.5])

    def found(weights):
        chain = walks.random_walk(graph, weights)
        moved = dataclasses.replace(policy, chain=chain, weights=weights / weights.sum())
        return patrol.capture_probabilities(graph, visible, [moved], attack)

    def dense(weights):
        matrix = walk_on(graph, weights)
        return np.array([[1 - missed(matrix, v, k, start) for v in visible.T] for k in (2, 5)])

    np.testing.assert_allclose(jax.jit(found)(jnp.asarray(weights)), dense(weights), rtol=1e-12)
    slopes = jax.jit(jax.jacrev(found))(jnp.asarray(weights))
    for edge in range(4):
        step = 1e-5 * np.eye(4)[edge]
        expected = (dense(weights + step) - dense(weights - step)) / 2e-5
        np.testing.assert_allclose(slopes[..., edge], expected, atol=1e-9)


def test_times_on_a_perimeter_have_the_derivatives_of_a_gambler():
    robots = perimeter.Perimeter(10, 2, perimeter.Movement.BMP)

    def exact(p):
        # A gambler who wins a bet with probability 1 - p, and stops with 0 or 5.
        ratio = p[0] / (1 - p[0])
        drift = 2 * p[0] - 1
        ruined = [i / drift - 5 / drift * (1 - ratio**i) / (1 - ratio**5) for i in range(1, 5)]
        return [1 + p[0] * ruined[-1] + (1 - p[0]) * ruined[0], *ruined]

    def found(p):
        return perimeter.mean_hitting_times(robots, p)

    values = jax.jit(jax.vmap(found))(jnp.array([0.25, 0.375]))
    for p, value in zip((0.25, 0.375), values, strict=True):
        np.testing.assert_allclose(value, np.array(exact([Fraction(p)]), float), rtol=1e-12)
    slope = jax.jit(jax.jacfwd(found))(0.375)
    np.testing.assert_allclose(slope, difference(exact, [0.375], 0), rtol=1e-9, atol=1e-13)


def test_the_law_on_a_perimeter_has_the_derivatives_of_its_polynomials():
    """The probability of a visit after each step is a polynomial of p with a term for each way."""
    robots = perimeter.Perimeter(6, 2, perimeter.Movement.BMP)
    slope = jax.jit(jax.jacrev(lambda p: perimeter.hitting_law(robots, p, 3)))(0.3)
    # Segment 1: ahead at once with p; back, and back again; back, ahead, ahead.
    p, q = 0.3, 0.7
    np.testing.assert_allclose(slope[1], [1, -2 * q, p * (2 * q - p)], rtol=1e-12)


def test_measures_have_the_derivatives_of_two_vertices():
    """In a compiled batch of chains that change their vertex with probabilities a and b."""

    def found(a, b):
        P = jnp.stack([jnp.stack([1 - a, a]), jnp.stack([b, 1 - b])])
        walk = walks.measure(Chain.from_scipy(P))
        times = walk.hitting_time[0, 1], walk.mean_commute_time, walk.kemeny_constant
        return jnp.stack([*walk.stationary, *times, walk.slem, walk.entropy_rate_nats])

    def exact(a, b):
        chance = [np.array([1 - a, a]), np.array([1 - b, b])]
        surprise = [-p @ np.log(p) for p in chance]
        times = 1 / a, 1 / a + 1 / b, 1 / (a + b)
        rate = (b * surprise[0] + a * surprise[1]) / (a + b)
        return np.array([b / (a + b), a / (a + b), *times, abs(1 - a - b), rate])

    a, b = np.array([0.1, 0.3, 0.6]), np.array([0.2, 0.4, 0.7])
    values = jax.jit(jax.vmap(found))(a, b)
    slopes = jax.jit(jax.vmap(jax.jacrev(found, (0, 1))))(a, b)
    for row, value in enumerate(values):
        at = a[row], b[row]
        np.testing.assert_allclose(value, exact(*at), rtol=1e-13)
        for of, h in zip(slopes, np.eye(2) * 1e-6, strict=True):
            central = (exact(*(at + h)) - exact(*(at - h))) / 2e-6
            np.testing.assert_allclose(of[row], central, rtol=1e-8, atol=1e-12)


def test_a_second_derivative_of_a_commute_time_is_refused():
    def found(weights):
        return walks.measure(walks.random_walk(KITE, weights)).mean_commute_time

    with pytest.raises(TypeError, match="expected no second derivative; only the first one"):
        jax.hessian(found)(jnp.asarray(WEIGHTS))


def test_measures_of_a_program_are_those_of_the_host():
    alone = walks.measure(walks.random_walk(KITE, WEIGHTS))
    found = jax.jit(lambda w: walks.measure(walks.random_walk(KITE, w)))(WEIGHTS)
    for name in ("transition", "stationary", "hitting_time", "mixing_time", "mean_time_to"):
        np.testing.assert_allclose(getattr(found, name), getattr(alone, name), rtol=1e-13)
    # Vertex 3 is not visited in the long run.
    chain = Chain([[1, 2, 0, 0]], np.ones((1, 4)))
    lost = jax.jit(lambda p: walks.measure(Chain(chain.image, p)))(chain.probability)
    assert np.isnan(lost.kemeny_constant)
    np.testing.assert_allclose(lost.stationary, walks.measure(chain).stationary)
