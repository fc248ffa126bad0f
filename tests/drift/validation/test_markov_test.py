import numpy as np

from jaxcell import drift
from jaxcell.mapping import Chain, ChainSequence


def random_chain(random, cells=6):
    matrix = random.random((cells, cells)) * (random.random((cells, cells)) < 0.5)
    matrix /= np.maximum(matrix.sum(axis=1, keepdims=True), 1) * 1.1
    return matrix, Chain.from_scipy(matrix)


def test_shares_by_the_map_are_those_of_powers_of_its_matrix():
    random = np.random.default_rng(0)
    (first, one), (second, two) = random_chain(random), random_chain(random)
    sets = np.array([0, 0, -1, 1, 1, 1])
    origin = random.integers(0, 6, 500)
    end = np.where(random.random(500) < 0.3, -1, random.integers(0, 6, 500))
    tide = ChainSequence.of([one, two])
    test = drift.MarkovTest.of(tide, sets, 7200.0, [(1, origin, end), (5, origin, end)], 5.0, 2)
    assert test.number.tolist() == [2, 3, 2, 3]
    assert test.hours.tolist() == [2, 2, 10, 10]
    powers = {1: first, 5: first @ second @ first @ second @ first}
    cases = [(steps, number) for steps in (1, 5) for number in (0, 1)]
    for case, (steps, number) in enumerate(cases):
        inside = sets[origin] == number
        rows = powers[steps][origin[inside]]
        mapped = rows[:, sets == number].sum(axis=1).mean()
        seen = np.mean([cell >= 0 and sets[cell] == number for cell in end[inside]])
        np.testing.assert_allclose(test.by_map[case], mapped)
        np.testing.assert_allclose(test.by_drifters[case], seen)
        np.testing.assert_allclose(test.error[case], np.sqrt(seen * (1 - seen) / inside.sum()))
    assert test.apart == np.abs(test.by_map - test.by_drifters).max()
