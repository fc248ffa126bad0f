import numpy as np
from hypothesis import given, strategies as st
from random_chains import dense_solution, matrices, reachable
from random_models import as_model, models, policies

from jaxcell.base.certificate import Outcome
from jaxcell.mapping.generalized import Chain
from jaxcell.markov.conditional import arrival_probabilities, conditional_hitting_times
from jaxcell.markov.decision import DecisionModel, policy_chain
from jaxcell.markov.hitting import hitting_times
from jaxcell.markov.shortest_path import stochastic_shortest_path


def arriving(matrix, goal):
    """Compute the probability of arriving, and the mean time over paths that arrive, densely."""
    cells = len(matrix)
    there = np.arange(cells) == goal
    stopped = np.where(there[:, None], 0, matrix)
    inner = reachable(stopped)[:, goal] & ~there
    q, into = matrix[inner][:, inner], matrix[inner, goal]
    probability = np.where(there, 1.0, 0.0)
    probability[inner] = dense_solution(q, into)
    total = dense_solution(q, probability[inner])
    time = np.where(there, 0.0, np.inf)
    time[inner] = total / probability[inner]
    return probability, time


@given(matrices(), st.data())
def test_arriving_equals_dense_solves(matrix, data):
    goal = data.draw(st.integers(0, len(matrix) - 1))
    chain = Chain.from_scipy(matrix)
    probability, time = arriving(matrix, goal)
    result = arrival_probabilities(chain, goal)
    np.testing.assert_allclose(result.value, probability, rtol=1e-10, atol=1e-14)
    times = conditional_hitting_times(chain, goal)
    np.testing.assert_allclose(times.value, time, rtol=1e-9)
    # The probability is exactly 1 where the hitting time is finite.
    finite = np.isfinite(hitting_times(chain, goal).value)
    np.testing.assert_array_equal(np.asarray(result.value) == 1, finite)
    for solution in (result, times):
        assert solution.certificate.outcome is Outcome.CONVERGED


@given(models(), st.data())
def test_policy_is_the_surest_and_quickest_of_all(parts, data):
    matrices, _, allowed = parts
    cells = allowed.shape[1]
    goal = data.draw(st.integers(0, cells - 1))
    result = stochastic_shortest_path(as_model(*parts), goal)
    every = [arriving(matrices[policy, np.arange(cells)], goal) for policy in policies(allowed)]
    best = np.max([probability for probability, _ in every], axis=0)
    as_sure = [
        np.where(probability >= best * (1 - 1e-9), time, np.inf) for probability, time in every
    ]
    np.testing.assert_allclose(result.probability, best, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(result.conditional_time, np.min(as_sure, axis=0), rtol=1e-8)
    surely = np.max([hits(matrices, policy, goal) for policy in policies(allowed)], axis=0)
    np.testing.assert_array_equal(np.isfinite(result.time), surely)
    np.testing.assert_array_equal(np.asarray(result.probability) == 1, surely)
    # The policy attains all of them.
    own = arriving(matrices[np.asarray(result.policy), np.arange(cells)], goal)
    np.testing.assert_allclose(own[0], best, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(own[1], result.conditional_time, rtol=1e-8)
    assert allowed[np.asarray(result.policy), np.arange(cells)].all()
    assert result.certificate.outcome is Outcome.CONVERGED


def hits(matrices, policy, goal):
    chain = Chain.from_scipy(matrices[policy, np.arange(policy.size)])
    return np.isfinite(hitting_times(chain, goal).value)


def test_certain_arrival_is_preferred_to_a_quick_one():
    # From cell 0, the robot arrives at once with probability 0.9, else is lost; or by a detour.
    gamble = np.zeros((4, 4))
    gamble[0, 3] = 0.9
    detour = np.zeros((4, 4))
    detour[0, 1] = detour[1, 2] = detour[2, 3] = 1
    gamble[1:] = detour[1:]
    model = as_model(np.stack([gamble, detour]), np.zeros((2, 4)), np.ones((2, 4), bool))
    result = stochastic_shortest_path(model, 3)
    assert result.probability.tolist() == [1, 1, 1, 1]
    assert result.time.tolist() == [3, 2, 1, 0]
    assert result.policy.tolist()[0] == 1


def test_larger_models_keep_their_certificate():
    draw = np.random.default_rng(0)
    cells = 400
    chains = [
        Chain(draw.integers(0, cells, (3, cells)), draw.dirichlet([1, 1, 1, 0.02], cells).T[:3])
        for _ in range(3)
    ]
    model = DecisionModel.of(chains, np.zeros((3, cells)))
    result = stochastic_shortest_path(model, [7, 8])
    assert result.certificate.outcome is Outcome.CONVERGED
    loop = policy_chain(model, result.policy)
    np.testing.assert_allclose(
        arrival_probabilities(loop, [7, 8]).value, result.probability, rtol=1e-8
    )
    np.testing.assert_allclose(
        conditional_hitting_times(loop, [7, 8]).value, result.conditional_time, rtol=1e-7
    )
    # No single action does better than the policy (Bellman's equation).
    probability = np.array(result.probability)
    for chain in chains:
        later = np.array(chain.pull(result.probability))
        later[[7, 8]] = 0
        assert (later <= probability + 1e-9).all()
