"""Members of sweeps of patrols are computed together, with the numbers of studies of their own.

The truth on small graphs is exact, from the law of the time of a visit.
"""

from fractions import Fraction

import numpy as np
import pytest

from jaxcell.patrol import Graph
from jaxcell.study import PatrolGraph, PatrolMap
from jaxcell.study.study import scalars


TRIANGLE = Graph([(0, 1), (1, 2), (2, 0)])


def same(found, studies):
    """Members have the bytes of single studies."""
    alone = [scalars(study.run(), ()) for study in studies]
    names = {name for one in alone for name in one}
    assert names == found.keys()
    for name in names:
        column = np.broadcast_to(found[name][1], len(studies))
        expected = [one[name][1] if name in one else np.nan for one in alone]
        np.testing.assert_array_equal(column, np.stack(expected), err_msg=name)


@pytest.mark.parametrize("robots", [1, 2])
def test_captures_on_a_triangle_are_exact(robots):
    times = np.array([5, 1, 3, 3, 30])
    study = PatrolGraph(TRIANGLE, attack_time=1, robots=robots)
    found = study.numbers({"attack_time": times})
    for place, time in enumerate(times.tolist()):
        # A robot that leaves a vertex is back after 1 + k steps with the probability 2^-k.
        returns = 1 - Fraction(2, 2**time)
        seen = (1 + sum(Fraction(2, 2**k) for k in range(1, time))) / 3
        for name, one in (("least_capture", returns), ("least_blind_capture", seen)):
            truth = float(1 - (1 - one) ** robots)
            np.testing.assert_allclose(found[name][1][place], truth, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    "options",
    [
        {"robots": 2},
        {"strategy": "toward", "vertex": "3"},
        {"speed": 0.5, "time_unit": 0.7},
        {"speed": 0.5},
        {"file": TRIANGLE, "strategy": "capture"},
        {"division": "partition", "robots": 2},
    ],
)
def test_members_of_patrols_of_a_graph_are_those_of_single_studies(options):
    times = np.array([16, 14, 16])
    options = {"file": "@eight", **options}
    studies = [PatrolGraph(attack_time=time, **options) for time in times.tolist()]
    same(studies[0].numbers({"attack_time": times}), studies)


def test_only_wanted_numbers_are_computed():
    study = PatrolGraph("@eight", attack_time=5)
    found = study.numbers({"attack_time": np.arange(5, 8)}, lambda name: name == "least_capture")
    assert found.keys() == {"least_capture"}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"strategy": "capture"}, "attack_time: a robot needs"),
        ({"speed": 0.5, "time_unit": 5.0}, "attack_time: expected at least 1, got 0"),
    ],
)
def test_attack_that_is_too_short_is_refused_as_alone(options, reason):
    studies = [PatrolGraph("@eight", attack_time=time, **options) for time in (2, 20)]
    with pytest.raises(ValueError, match=reason) as alone:
        studies[0].run()
    with pytest.raises(ValueError, match=reason) as together:
        studies[1].numbers({"attack_time": np.array([20, 2])})
    assert str(alone.value) == str(together.value)


@pytest.mark.parametrize(
    "options",
    [{}, {"base": "auto", "distribution": "worst"}, {"share": 0.5, "distribution": "uniform"}],
)
def test_members_of_patrols_of_a_map_are_those_of_single_studies(options):
    times = np.array([9, 2, 9])
    studies = [
        PatrolMap("@lab_a", attack_times=(time,), range=3.0, runs=50, **options)
        for time in times.tolist()
    ]
    same(studies[0].numbers({"attack_times": times}), studies)


def test_captures_on_a_map_are_those_of_powers_of_matrices():
    times = np.array([1, 4, 25])
    study = PatrolMap("@lab_a", attack_times=(1,), range=3.0, runs=2, share=0.0, robots=1)
    found = study.numbers({"attack_times": times}, "least_capture".__eq__)["least_capture"][1]
    result = study.run()
    walk = result.policies[0].chain.to_scipy().toarray()
    # All robots are as in the long run, by the detailed balance of a walk with weights.
    share = np.bincount(result.graph.edges.ravel(), np.repeat(result.policies[0].weights, 2))
    for time, least in zip(times.tolist(), found, strict=True):
        caught = []
        for target in range(len(walk)):
            hidden = np.flatnonzero(~result.visible[:, target])
            if hidden.size:
                stay = np.linalg.matrix_power(walk[np.ix_(hidden, hidden)], time).sum(axis=1)
                caught.append(1 - share[hidden] @ stay / share[hidden].sum())
        assert least == pytest.approx(min(caught), rel=1e-12)
