"""Chains of stochastic differential equations, compared with quadrature of exact integrals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from jaxcell import dynamics, mapping, markov
from jaxcell.space import Box


def integrals(force, noise, low, high, places):
    """Integrate the scale function, and the speed measure times it, from `low`, at `places`."""
    x = np.linspace(low, high, 8001)
    spread = np.broadcast_to(noise(x) ** 2 / 2, x.shape)
    power = cumulative_simpson(force(x) / spread, x=x, initial=0)
    scale = cumulative_simpson(np.exp(-power), x=x, initial=0)
    speed = cumulative_simpson(np.exp(power) / spread, x=x, initial=0)
    both = cumulative_simpson(np.exp(-power) * speed, x=x, initial=0)
    return [(np.interp(places, x, one), one[-1]) for one in (scale, both)]


def exit_times(force, noise, low, high, places):
    (scale, last), (both, whole) = integrals(force, noise, low, high, places)
    return scale / last * whole - both


def reach_times(force, noise, low, high, places):
    """Mean times to `high`, where `low` reflects."""
    both, whole = integrals(force, noise, low, high, places)[1]
    return whole - both


def times(diffusion):
    ends = len(diffusion.ends)
    cells = diffusion.chain.cells - ends
    steps = markov.hitting_times(diffusion.chain, np.arange(cells, cells + ends)).value
    return np.asarray(diffusion.duration * steps)[:cells]


# Published exit times of an Ornstein-Uhlenbeck process from the middle of an interval.
@pytest.mark.parametrize(("half", "known"), [(1.5, 5.7265), (2.0, 27.4327)])
def test_exit_of_an_ornstein_uhlenbeck_process(half, known):
    box = Box([-half], [half], [81])
    found = times(dynamics.diffusion(lambda x, p: -x, box, noise=1.0))
    exact = exit_times(lambda x: -x, np.ones_like, -half, half, box.ticks(0))
    assert exact[40] == pytest.approx(known, abs=1e-4)
    np.testing.assert_allclose(found, exact, rtol=2e-3)


# Published mean times of Kramers' problem from the bottom of a well to the top of the barrier.
@pytest.mark.parametrize(("noise", "known"), [(0.6, 9.3769), (0.5, 18.4262), (0.4, 57.478)])
def test_escape_from_a_double_well(noise, known):
    def exact(x):
        return reach_times(lambda x: x - x**3, lambda x: noise + 0 * x, -3, 0, x)

    box = Box([-3], [1], [160], "clamp")
    into = box.ticks(0) > 0
    found = times(dynamics.diffusion(lambda x, p: x - x**3, box, noise=noise, into=into))
    assert exact(np.array([-1.0]))[0] == pytest.approx(known, rel=1e-4)
    np.testing.assert_allclose(found[40:120], exact(box.ticks(0)[40:120]), rtol=2e-3)


@pytest.mark.parametrize("high", [0.43, 0.5, 0.551])
def test_errors_fall_with_the_square_of_the_width_wherever_a_region_begins(high):
    errors = []
    for cells in (30, 60, 120):
        box = Box([-2], [1], [cells], "clamp")
        found = times(
            dynamics.diffusion(
                lambda x, p: -x + 0.3, box, noise=0.6, into=lambda x: x[:, 0] >= high
            )
        )
        exact = reach_times(lambda x: 0.3 - x, lambda x: 0.6 + 0 * x, -2, high, box.ticks(0))
        alive = box.ticks(0) < high
        errors.append(np.abs(found - exact)[alive].max() / exact.max())
    assert errors[2] < 4e-4
    assert errors[2] < errors[0] / 10


def test_noise_that_depends_on_the_state_is_that_of_ito():
    # Logistic growth with demographic noise, until the population falls below 0.1.
    def noise(x, p):
        return 0.6 * jnp.sqrt(x)

    box = Box([0.1], [4.1], [200], ("sink",))
    found = times(dynamics.diffusion(lambda x, p: x * (1 - x), box, noise=noise))
    exact = exit_times(lambda x: x * (1 - x), lambda x: 0.6 * np.sqrt(x), 0.1, 4.1, box.ticks(0))
    np.testing.assert_allclose(found, exact, rtol=3e-3)


def test_stationary_distribution_is_that_of_boltzmann():
    box = Box([-2, -1.5], [2, 1.5], [50, 40], "clamp")

    def field(x, p):
        return jnp.stack([x[0] - x[0] ** 3 - x[1], -2 * x[1] - x[0]])

    diffusion = dynamics.diffusion(field, box, noise=0.7)
    assert diffusion.ends == ()
    found = markov.limiting_distribution(diffusion.chain).value
    x, y = box.centre(np.arange(box.size, dtype=np.int32)).T
    energy = -(x**2) / 2 + x**4 / 4 + y**2 + x * y
    exact = np.exp(-2 * energy / 0.7**2)
    np.testing.assert_allclose(found / found.sum(), exact / exact.sum(), rtol=0.01, atol=1e-6)


def test_times_of_brownian_motion_in_a_disc_and_on_a_ring():
    box = Box([-1.1, -1.1], [1.1, 1.1], [40, 40])
    disc = dynamics.diffusion(
        lambda x, p: 0 * x, box, noise=1.0, into=lambda x: np.hypot(*x.T) >= 1
    )
    radius = np.hypot(*box.centre(np.arange(box.size, dtype=np.int32)).T)
    # The mean time is (1 - r^2) / 2 in two dimensions.
    np.testing.assert_allclose(times(disc), np.maximum(0, (1 - radius**2) / 2), atol=2e-3)
    ring = Box([0], [1], [50], "periodic")
    walk = dynamics.diffusion(
        lambda x, p: 0 * x, ring, noise=1.0, into=lambda x: np.abs(x[:, 0] - 0.5) <= 0.113
    )
    outside = np.abs(ring.ticks(0) - 0.5) > 0.113
    exact = exact_on_ring(ring.ticks(0))
    np.testing.assert_allclose(times(walk)[outside], exact[outside], atol=1e-4)


def exact_on_ring(x):
    """Return the mean time of Brownian motion until it is within 0.113 of 0.5 on a ring."""
    arc = 1 - 2 * 0.113
    along = np.abs(x - 0.5) - 0.113
    return np.where(along > 0, along * (arc - along), 0.0)


def test_time_of_1e188_has_its_digits():
    box = Box([-1.5], [0.5], [240], "clamp")
    found = times(
        dynamics.diffusion(lambda x, p: x - x**3, box, noise=0.034, into=lambda x: x[:, 0] >= 0)
    )
    exact = reach_times(lambda x: x - x**3, lambda x: 0.034 + 0 * x, -1.5, 0, box.ticks(0))
    assert 1e187 < exact[60] < 1e191
    np.testing.assert_allclose(found[:150], exact[:150], rtol=0.02)


def test_derivatives_equal_differences():
    box = Box([-3], [1], [60], "clamp")

    def time(values):
        def noise(x, p):
            return values[1] + p["more"] * x[0] ** 2

        diffusion = dynamics.diffusion(
            lambda x, p: values[0] * x - x**3,
            box,
            {"more": values[2]},
            noise=noise,
            into=lambda x: x[:, 0] >= 0,
        )
        return diffusion.duration * markov.hitting_times(diffusion.chain, 60).value[30]

    start, step = np.array([1.0, 0.4, 0.05]), 1e-5
    with jax.enable_x64(True):
        found = jax.grad(lambda v: time(v))(jnp.asarray(start))
    for k in range(3):
        ends = [float(time(start + sign * step * np.eye(3)[k])) for sign in (-1, 1)]
        assert found[k] == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=1e-6)


def test_every_cell_of_a_batch_of_noises_is_that_of_a_single_call():
    box = Box([-1], [1], [30])

    def time(noise):
        diffusion = dynamics.diffusion(lambda x, p: -x, box, noise=noise)
        return diffusion.duration * markov.hitting_times(diffusion.chain, [30, 31]).value

    noises = np.array([0.5, 0.8])
    with jax.enable_x64(True):
        found = jax.jit(jax.vmap(time))(jnp.asarray(noises))
    for noise, own in zip(noises, found, strict=True):
        np.testing.assert_allclose(own, time(float(noise)), rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": -1.0}, "noise: expected numbers from 0"),
        ({"noise": (1.0, 1.0)}, "noise: expected one number, or one for each axis"),
        ({"noise": 1.0, "into": lambda x: x[:, 0]}, "target: expected a function of points"),
        ({"noise": 1.0, "into": [70]}, r"target\[0\]: cell 70"),
    ],
)
def test_wrong_arguments_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        dynamics.diffusion(lambda x, p: -x, Box([-1], [1], [30]), **options)


def test_a_process_in_a_region_is_at_its_end():
    box = Box([0], [1], [10])
    walk = dynamics.diffusion(lambda x, p: 0 * x, box, noise=1.0, into={"low": [0, 1], "high": [9]})
    assert walk.ends == ("low", "high", "below x0", "above x0")
    matrix = walk.chain.to_scipy().toarray()
    assert (matrix[[0, 1, 9], [10, 10, 11]] == 1).all()
    assert (np.diag(matrix)[10:] == 1).all()
    groups = mapping.persistent_groups(walk.chain)
    assert int(groups.count) == 4
