"""Attractors of systems whose long-run behaviour is known: points, cycles and periods."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.space import Box


def oscillator(x, p):
    return jnp.stack([x[1], -2 * p["d"] * x[1] - x[0] - x[0] ** 3])


@pytest.mark.parametrize("damping", [0.003, 0.01, 0.3])
@pytest.mark.parametrize("steps", [20, "crossing"])
def test_weakly_damped_oscillator_ends_at_one_point(damping, steps):
    box = Box([-2, -2], [2, 2], [61, 61])
    basins = dynamics.basins(dynamics.flow(oscillator, 0.05, steps), box, {"d": damping})
    assert (basins.settled, basins.period.tolist()) == (True, [1])
    assert [cells.tolist() for cells in basins.attractor_cells] == [[61 * 30 + 30]]
    np.testing.assert_allclose(basins.orbit, 0, atol=1e-9)


def test_undecided_orbits_have_not_settled_and_a_remark_names_the_way_on():
    basins = dynamics.basins(lambda x, p: (1 - 1e-6) * x, Box([-1], [1], [31]))
    assert not basins.settled
    (remark,) = (r for r in basins.remarks if "had not settled" in r)
    for part in ("powers of time", "bifurcation", "take longer mappings", "finer cells"):
        assert part in remark


def drag(x, p):
    return jnp.stack([x[1], -x[0] - p["q"] * x[1] * jnp.abs(x[1])])


def hopf(x, p):
    return p["m"] * x + jnp.stack([-x[1], x[0]]) - x * (x @ x)


def semistable(x, p):
    """Turn at speed 1, while the radius falls at the rate `r ((r - 1)^2 + a)`."""
    return jnp.stack([-x[1], x[0]]) - x * ((jnp.sqrt(x @ x) - 1) ** 2 + p["a"])


LINE, PLANE = Box([-1], [1], [31]), Box([-2, -2], [2, 2], [61, 61])
COARSE = Box([-2, -2], [2, 2], [21, 21])
ROUND, UNIT = Box([0], [1], [200], "periodic"), Box([0], [1], [500])


def drawn(low, high, count):
    return np.random.default_rng(3).uniform(low, high, count)


# Distances from these orbits fall with powers of time; or the attractor has just vanished.
ALGEBRAIC = {
    "drag": (20, drag, PLANE, {"q": [0.01, *drawn(0.01, 0.2, 2), 0.2]}),
    "third power": (20, lambda x, p: -p["c"] * x**3, LINE, {"c": drawn(0.5, 2, 2)}),
    "ninth power": (20, lambda x, p: -p["c"] * x**9, LINE, {"c": [1.0]}),
    "product": (20, lambda x, p: -jnp.stack([x[0] ** 3, p["c"] * x[1]]), PLANE, {"c": [0.5]}),
    "hopf": (20, hopf, COARSE, {"m": [0.0, *drawn(-2e-5, 2e-5, 2)]}),
    "ghost": (20, lambda x, p: p["a"] + x**2, LINE, {"a": [1e-10, 1e-8, 1e-7]}),
    "coarse ghost": (20, lambda x, p: p["a"] + x**2, Box([-1], [1], [4]), {"a": [1e-9]}),
    "ghost of a cycle": (20, semistable, PLANE, {"a": [1e-11, 1e-9]}),
    "sine": (0, lambda x, p: p["s"] * jnp.sin(x), LINE, {"s": [1.0, -1.0]}),
    "cubic map": (0, lambda x, p: x - p["c"] * x**3, LINE, {"c": [1.0, 0.3]}),
    "ghost of a map": (0, lambda x, p: x + p["a"] + x**2, LINE, {"a": [1e-8, 1e-9]}),
    "doubling of periods": (
        0,
        lambda x, p: p["r"] * x * (1 - x),
        UNIT,
        {"r": [1.0, 3.0, 3.4494, 1 + 6**0.5]},
    ),
    "no attraction": (20, lambda x, p: jnp.stack([x[1], -p["k"] * x[0]]), PLANE, {"k": [1.0, 2.0]}),
}


@pytest.mark.parametrize("name", ALGEBRAIC)
def test_algebraic_approaches_and_ghosts_have_not_settled(name):
    steps, own, box, params = ALGEBRAIC[name]
    branches = dynamics.continuation(
        dynamics.flow(own, 0.05, steps) if steps else own,
        box,
        {key: np.asarray(value, float) for key, value in params.items()},
    )
    for basins in branches.members:
        assert not basins.settled or not basins.attractors


def two_cycles(x, p):
    each = (x[:2], 1.0), (x[2:], p["w"])
    return jnp.concatenate([y * (1 - y @ y) + w * jnp.stack([-y[1], y[0]]) for y, w in each])


def lorenz(x, p):
    return jnp.stack(
        [10 * (x[1] - x[0]), x[0] * (p["r"] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]
    )


# Points, quasi-periodic orbits and chaos that attract exponentially, and their periods in mappings.
EXPONENTIAL = {
    "sine": (lambda x, p: p["s"] * jnp.sin(x), LINE, {"s": [0.99, -0.97, 0.0]}, 1),
    "node": (lambda x, p: p["s"] * jnp.sin(x)[::-1], PLANE, {"s": [0.95, -0.95, 0.5]}, 1),
    "focus in 3 axes": (
        lambda x, p: p["s"] * jnp.roll(jnp.sin(x), 1),
        Box([-1] * 3, [1] * 3, [11] * 3),
        {"s": [0.95, 0.3]},
        1,
    ),
    "turns": (lambda x, p: x + p["a"], ROUND, {"a": [0.5**0.5, 0.6180339887]}, 0),
    "circle": (
        lambda x, p: x + p["a"] + p["k"] / (2 * np.pi) * jnp.sin(2 * np.pi * x),
        ROUND,
        {"a": [0.606661, 0.606661], "k": [0.8, 0.3]},
        0,
    ),
    "locked circle": (
        lambda x, p: x + 0.5 + p["k"] / (2 * np.pi) * jnp.sin(2 * np.pi * x),
        ROUND,
        {"k": [0.9, 0.6]},
        2,
    ),
    "torus": (
        dynamics.flow(two_cycles, 0.05, 20),
        Box([-1.5] * 4, [1.5] * 4, [9] * 4),
        {"w": [5**0.5 / 2 + 0.5, 2**0.5]},
        0,
    ),
    "henon": (
        lambda x, p: jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], 0.3 * x[0]]),
        Box([-2, -2], [2, 2], [151, 151]),
        {"a": [1.4, 1.39]},
        0,
    ),
    "parabola": (lambda x, p: p["r"] * x * (1 - x), UNIT, {"r": [4.0, 3.99]}, 0),
    "lorenz": (
        dynamics.flow(lorenz, 0.01, 20),
        Box([-25, -30, 0], [25, 30, 55], [20, 20, 20]),
        {"r": [28.0, 30.0]},
        0,
    ),
}


@pytest.mark.parametrize("name", EXPONENTIAL)
def test_exponential_approaches_have_settled(name):
    own, box, params, period = EXPONENTIAL[name]
    branches = dynamics.continuation(own, box, {k: np.asarray(v) for k, v in params.items()})
    for basins in branches.members:
        assert basins.settled
        assert set(basins.period.tolist()) == {period}


def sickness(x, p):
    """Spread a sickness, whose rate is `q`, besides linear terms."""
    new = 2 * p["q"] * x[0] * x[1]
    return jnp.stack([p["a"] * x[0] + p["b"] * x[1] - new, p["b"] * x[0] + p["c"] * x[1] + new])


def ring(x, p):
    along = jnp.stack([jnp.cos(p["angle"]), jnp.sin(p["angle"])])
    turned = jnp.stack([along[0] * x[0] - along[1] * x[1], along[1] * x[0] + along[0] * x[1]])
    return (1 + p["pull"] * (1 - x @ x)) * turned


# Continua of points and cycles: infected people and a line of equilibria, marbles that approach
# each other, a line that attracts, rest; cycles at any height; cycles of three points, identity.
NEUTRAL = {
    "points": (
        dynamics.flow(sickness, 0.05, 20),
        Box([-1, -1], [1, 1], [9, 9]),
        {
            "q": [1.0, 0.0, 0.0, 0.0],
            "a": [0.0, -1.0, 0.0, 0.0],
            "b": [0.0, 1.0, 0.0, 0.0],
            "c": [-1.0, -1.0, -1.0, 0.0],
        },
    ),
    "cycles": (
        dynamics.flow(lambda x, p: jnp.append(hopf(x[:2], p), 0 * x[2]), 0.05, 20),
        Box([-1.5, -1.5, 0], [1.5, 1.5, 1], [7, 7, 3]),
        {"m": [1.0]},
    ),
    "cycles of points": (
        ring,
        Box([-1.4] * 2, [1.4] * 2, [15, 15]),
        {"angle": [2 * np.pi / 3, 0.0], "pull": [0.1, 0.0]},
    ),
}


@pytest.mark.parametrize("name", NEUTRAL)
def test_continua_have_not_settled_and_a_remark_says_that_cells_divide_them(name):
    own, box, params = NEUTRAL[name]
    branches = dynamics.continuation(own, box, {k: np.asarray(v) for k, v in params.items()})
    for basins in branches.members:
        assert basins.attractors
        assert not basins.settled
        (remark,) = (r for r in basins.remarks if "had not settled" in r)
        for part in ("neither attracts nor repels", "continuum", "depends on the cells"):
            assert part in remark


def lienard(x, p):
    bend = p["m"] * (x[0] - x[0] ** 3 / 3 - x[1])
    return jnp.stack([bend + p["i"], p["e"] * (x[0] + p["a"] - p["b"] * x[1])])


def test_relaxation_oscillations_have_settled():
    """Follow the oscillators of van der Pol (`m` = 5 and 8), and of FitzHugh and Nagumo."""
    params = {
        "m": np.array([5.0, 8.0, 1.0]),
        "e": np.array([1 / 5, 1 / 8, 0.01]),
        "i": np.array([0.0, 0.0, 0.5]),
        "a": np.array([0.0, 0.0, 0.7]),
        "b": np.array([0.0, 0.0, 0.8]),
    }
    flow = dynamics.flow(lienard, 0.03, 20)
    branches = dynamics.continuation(flow, Box([-3, -2], [3, 3], [15, 15]), params)
    assert branches.settled.all()
    assert branches.branch_kind == ["cycle"] * 3
    np.testing.assert_allclose(branches.branch_return_time[:2], [11.6122, 16.0382], rtol=1e-4)


def test_slow_turn_has_settled():
    box = Box([-np.pi], [np.pi], [21], "periodic")
    basins = dynamics.basins(dynamics.flow(lambda x, p: 1.001 - jnp.cos(x), 0.05, 20), box)
    assert (basins.settled, basins.kind) == (True, ["cycle"])
    period = 2 * np.pi / np.sqrt(1.001**2 - 1)
    np.testing.assert_allclose(basins.return_time, period, rtol=1e-4)


def test_answers_without_attractors_do_not_say_that_orbits_have_settled():
    def away(x, p):
        return 0.9 * x + p["a"]

    basins = dynamics.basins(away, Box([-1], [1], [11]), {"a": 0.5})
    branches = dynamics.continuation(away, Box([-1], [1], [11]), {"a": np.array([0.5, 0.6])})
    assert basins.answer == branches.answer == ("No attractor was found.",)


def test_exact_orbits_on_a_repelling_cycle_have_not_settled():
    # The doubling map moves all bits of a number out; what is left is the repelling point 0.
    basins = dynamics.basins(lambda x, p: 2 * x - jnp.floor(2 * x), Box([0], [1], [64], "periodic"))
    assert not basins.settled


# Onsets of the periods 2, 4, 8, 16 and 32 of the logistic map.
ONSETS = [1, 3, 1 + 6**0.5, 3.5440903596, 3.5644072661, 3.5687594195]


def test_periods_of_the_logistic_map_are_those_between_its_bifurcations():
    rng = np.random.default_rng(0)
    for k, (low, high) in enumerate(itertools.pairwise(ONSETS)):
        rates = low + (high - low) * np.array([0.02, 0.98, *rng.uniform(0.02, 0.98, 3)])
        branches = dynamics.continuation(
            lambda x, p: p["r"] * x * (1 - x), Box([0], [1], [500]), {"r": rates}
        )
        for basins in branches.members:
            assert basins.settled
            assert basins.period.tolist() == [2**k]


def test_random_foci_are_points_and_random_cycles_have_their_size():
    """Follows 12 normal forms of foci and cycles, seen through a random linear change."""
    box, rng, count = Box([-3, -3], [3, 3], [30, 30]), np.random.default_rng(1), 12

    def field(x, p):
        shear = jnp.stack([jnp.stack([p["a"], p["b"]]), jnp.stack([p["c"], p["d"]])])
        y = jnp.stack([p["d"] * x[0] - p["b"] * x[1], p["a"] * x[1] - p["c"] * x[0]])
        y = y / (p["a"] * p["d"] - p["b"] * p["c"])
        rate = p["growth"] - p["bend"] * (y @ y)
        return shear @ (rate * y + p["turn"] * jnp.stack([-y[1], y[0]]))

    growth = np.where(np.arange(count) % 2, 1, -1) * 10 ** rng.uniform(-2.5, -0.5, count)
    params = {
        "growth": growth,
        "bend": np.abs(growth) * rng.uniform(0.7, 3, count),
        "turn": rng.uniform(0.5, 2, count),
        "a": rng.uniform(0.8, 1.2, count),
        "b": rng.uniform(-0.3, 0.3, count),
        "c": rng.uniform(-0.3, 0.3, count),
        "d": rng.uniform(0.8, 1.2, count),
    }
    branches = dynamics.continuation(dynamics.flow(field, 0.05, 20), box, params)
    settled = 0
    for k, basins in enumerate(branches.members):
        if not basins.settled:
            continue
        settled += 1
        shear = np.array([[params[n][k] for n in row] for row in ("ab", "cd")])
        for orbit, period in zip(basins.orbit, basins.period, strict=True):
            radius = np.linalg.norm(np.linalg.solve(shear, orbit.T), axis=0)
            size = np.sqrt(max(0, growth[k] / params["bend"][k]))
            # The unstable focus inside a cycle is found only by orbits that start on it.
            np.testing.assert_allclose(radius, size, atol=0.0375)
            assert period == (growth[k] < 0)
    assert settled >= 0.9 * count


def test_random_maps_near_a_turn_are_points_or_curves():
    """Iterates 20 maps that turn by a random angle, and shrink slowly or to a circle."""
    box, rng, count = Box([-2, -2], [2, 2], [60, 60]), np.random.default_rng(2), 20

    def turn(x, p):
        rate = 1 + p["growth"] * (1 - p["bend"] * (x @ x))
        along = jnp.stack([jnp.cos(p["angle"]), jnp.sin(p["angle"])])
        across = along[0] * x[1] + along[1] * x[0]
        return rate * jnp.stack([along[0] * x[0] - along[1] * x[1], across])

    growth = np.where(np.arange(count) % 2, 1, -1) * 10 ** rng.uniform(-2.5, -0.7, count)
    params = {
        "growth": growth,
        "bend": np.where(growth > 0, rng.uniform(0.5, 2, count), -0.05),
        "angle": rng.uniform(0.2, 3, count),
    }
    branches = dynamics.continuation(turn, box, params)
    settled = [basins.settled for basins in branches.members]
    for k in np.flatnonzero(settled):
        basins = branches.members[k]
        size = np.sqrt(1 / params["bend"][k]) if growth[k] > 0 else 0.0
        radius = np.linalg.norm(basins.orbit, axis=-1)
        np.testing.assert_allclose(radius, size, atol=0.5 * box.width.max())
        if growth[k] < 0:
            assert basins.period.tolist() == [1]
    assert np.mean(settled) >= 0.9


def test_cycle_of_a_map_without_forward_derivative_settles():
    @jax.custom_vjp
    def halve(x):
        return x / 2

    halve.defvjp(lambda x: (x / 2, None), lambda _, slope: (slope / 2,))
    basins = dynamics.basins(lambda x, p: halve(x), Box([-1], [1], [21]))
    assert (basins.settled, basins.period.tolist()) == (True, [1])
