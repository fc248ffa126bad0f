import numpy as np
from small_seas import random_layers

from jaxcell.drift.pushed import push, pushed
from jaxcell.mapping import ChainSequence


def test_each_step_is_one_by_the_transition_matrix_of_its_phase():
    chains = [random_layers(seed, leak=0.1)[1][0] for seed in range(3)]
    share = np.random.default_rng(0).dirichlet(np.ones(chains[0].cells))
    expected = [share]
    for phase in (1, 2, 0, 1):
        expected.append(expected[-1] @ chains[phase].to_scipy())
    found = [*pushed(ChainSequence.of(chains), share, 4, start=1)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(push(chains[1], share, 1), expected[1], rtol=1e-12)
