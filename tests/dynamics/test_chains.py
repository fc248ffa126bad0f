import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxcell import dynamics, mapping, markov
from jaxcell.space import Box


def limiting(chain):
    return np.asarray(markov.limiting_distribution(chain, mapping.persistent_groups(chain)).value)


def test_the_chain_of_the_logistic_map_is_that_of_ulam():
    cells, samples = 64, 400
    chain = dynamics.chain(
        lambda x, p: 4 * x * (1 - x), Box([0], [1], [cells], "clamp"), samples=samples
    )
    # What part of a cell is mapped to another: both branches of the inverse are known.
    edges = np.linspace(0, 1, cells + 1)
    low = (1 - np.sqrt(1 - edges)) / 2
    exact = np.zeros((cells, cells))
    for ends in (low, 1 - low):
        left, right = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
        both = np.minimum(right, edges[1:, None]) - np.maximum(left, edges[:-1, None])
        exact += np.maximum(both, 0) * cells
    np.testing.assert_allclose(exact.sum(axis=1), 1)
    deviation = np.sqrt(exact * (1 - exact) / samples)
    assert (np.abs(chain.to_scipy().toarray() - exact) < 5 * deviation + 1e-9).all()
    # And its density is that of the arc sine, which the exact matrix of 64 cells misses by 0.14.
    density = np.diff(2 / np.pi * np.arcsin(np.sqrt(edges)))
    assert np.abs(limiting(chain) - density).sum() < 0.2


def test_noise_makes_the_gaussian_of_ornstein_and_uhlenbeck():
    box = Box([-4], [4], [100])
    decay = np.exp(-0.5)
    noise = np.sqrt((1 - decay**2) / 2)
    chain = dynamics.chain(lambda x, p: decay * x, box, samples=400, noise=noise)
    exact = np.diff(norm.cdf(np.linspace(-4, 4, 101), scale=np.sqrt(0.5)))
    kept = np.asarray(chain.to_scipy().sum(axis=1)).ravel()
    assert kept[50] == pytest.approx(1)
    # What leaves is a few in 10^7 at a time, so the shape inside is that of the limit.
    share = np.full(100, 0.01)
    for _ in range(40):
        share = np.asarray(chain.push(jnp.asarray(share)))
    assert np.abs(share / share.sum() - exact).sum() < 0.05


def test_what_leaves_the_box_goes_to_the_sink():
    box = Box([0], [1], [4])
    chain = dynamics.chain(lambda x, p: x + 0.5, box, samples=8)
    np.testing.assert_allclose(chain.leaving, [0, 0, 1, 1])
    assert chain.to_scipy().toarray()[:2, 2:].tolist() == [[1, 0], [0, 1]]


def test_a_key_makes_the_same_chain_again():
    box = Box([0], [1], [8], "periodic")
    one, same, other = (
        dynamics.chain(lambda x, p: x, box, noise=0.3, key=jax.random.key(k)) for k in (1, 1, 2)
    )
    assert (one.image == same.image).all()
    assert (one.image != other.image).any()


@pytest.mark.parametrize(
    ("options", "said"),
    [({"samples": 0}, "samples"), ({"noise": -1.0}, "noise"), ({"noise": float("nan")}, "noise")],
)
def test_bad_options_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        dynamics.chain(lambda x, p: x, Box([0], [1], [4]), **options)
