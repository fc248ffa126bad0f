"""Members of sweeps of patrols are computed together, with the numbers of studies of their own.

The truth on small graphs is exact, from the law of the time of a visit.
"""

import dataclasses
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
        {"charger": "2", "every": 8},
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


def test_attack_that_is_too_short_is_refused_as_alone():
    study = PatrolGraph("@eight", attack_time=20, strategy="capture")
    times = np.array([20, 2])
    with pytest.raises(ValueError, match="attack_time: a robot needs") as alone:
        dataclasses.replace(study, attack_time=2).run()
    with pytest.raises(ValueError, match="attack_time") as together:
        study.numbers({"attack_time": times})
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
