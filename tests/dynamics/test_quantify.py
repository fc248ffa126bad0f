import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.space import Box


def dumb(x, p):
    return jnp.where(x[0] >= 0, jnp.ones(2), -jnp.ones(2))


@pytest.fixture(scope="module")
def basins():
    """The example of Attractors.jl: nine cells, of which those with `x >= 0` go to (1, 1)."""
    return dynamics.basins(dumb, Box([-1.5, -1.5], [1.5, 1.5], [3, 3]))


def test_basin_stability_weighs_starts(basins):
    np.testing.assert_allclose(dynamics.basin_stability(basins), [2 / 3, 1 / 3])
    left = dynamics.basin_stability(basins, lambda x: (x[:, 0] < 0.5).astype(float))
    np.testing.assert_allclose(left, [0.5, 0.5])


def test_minimal_critical_shocks_equal_attractors_jl(basins):
    np.testing.assert_allclose(dynamics.minimal_critical_shock(basins), [2, 1])


def test_times_equal_attractors_jl(basins):
    # Attractors.jl divides sums over a basin by all nine starts.
    np.testing.assert_allclose(basins.mean_steps * [2 / 3, 1 / 3], [5 / 9, 2 / 9])
    np.testing.assert_allclose(dynamics.basin_stability(basins, within=0.5), [1 / 9, 1 / 9])


def test_crossing_times_equal_cell_by_cell_times():
    dt, crossed, most, cells = 0.05, 3, 100, 40
    flow = dynamics.flow(lambda x, p: -x, dt, crossed=crossed, max_steps=most)
    basins = dynamics.basins(flow, Box([0], [1], [cells]))
    decay = 1 - dt + dt**2 / 2 - dt**3 / 6 + dt**4 / 24

    def mapped(cell):
        place, steps = (cell + 0.5) / cells, 0
        while abs(int(place * cells) - cell) < crossed and steps < most:
            place, steps = place * decay, steps + 1
        return int(place * cells), steps * dt

    expected = np.zeros(cells)
    for start in range(cells):
        cell = start
        while basins.step[cell] > 0:
            cell, time = mapped(cell)
            expected[start] += time
    np.testing.assert_allclose(basins.time, expected, rtol=1e-5)
    assert np.unique(np.diff(basins.time).round(4)).size > 4
    np.testing.assert_allclose(basins.mean_time, expected.mean(), rtol=1e-5)
    assert dynamics.basin_stability(basins, within=2.0)[0] == np.mean(expected <= 2)


def test_newtons_method_has_basins_of_wada():
    def newton(x, p):
        z = jax.lax.complex(x[0], x[1])
        z = z - (z**3 - 1) / (3 * z**2)
        return jnp.stack([z.real, z.imag])

    basins = dynamics.basins(newton, Box([-2.01, -2], [2, 2], [200, 200]), follow=20)
    assert basins.attractors == 3
    np.testing.assert_allclose(basins.fraction, 1 / 3, atol=0.05)
    assert dynamics.wada(basins) < 0.05
    with pytest.raises(ValueError, match="wada: expected at least 3 basins, got 1"):
        dynamics.wada(dynamics.basins(lambda x, p: x / 2, Box([-1], [1], [9])))


def test_shocks_wrap_around_periodic_axes():
    box = Box([0, 0], [8, 1], [8, 1], ["periodic", "sink"])

    def map(x, p):
        return jnp.where((x[0] > 1) & (x[0] < 4), jnp.array([1.5, 0.5]), jnp.array([7.5, 0.5]))

    basins = dynamics.basins(map, box)
    # The cell 1.5 is two cells ahead of attractor 0 at 7.5, and 0.5 is beside attractor 1 at 1.5.
    np.testing.assert_allclose(dynamics.minimal_critical_shock(basins), [2, 1])


def test_one_basin_has_no_critical_shock_and_no_entropy():
    basins = dynamics.basins(lambda x, p: x / 2, Box([-1, -1], [1, 1], [9, 9]))
    assert dynamics.minimal_critical_shock(basins).tolist() == [np.inf]
    assert dynamics.basin_entropy(basins, 3) == (0, 0)
    assert np.isnan(dynamics.uncertainty_exponent(basins)[0])


def halves(cells):
    """The basins of a map of both halves of a square to one point each."""
    box = Box([-1, -1], [1, 1], [cells, cells])
    return dynamics.basins(lambda x, p: jnp.stack([jnp.sign(x[0]) * 0.5, 0 * x[1]]), box)


def test_entropy_of_a_straight_boundary_is_that_of_halves():
    straight = halves(40)
    # No box of 4 x 4 cells has both basins; the middle column of boxes of 8 x 8 cells has both.
    assert dynamics.basin_entropy(straight, 4) == (0, 0)
    whole, mixed = dynamics.basin_entropy(straight, 8)
    assert mixed == pytest.approx(np.log(2))
    assert whole == pytest.approx(np.log(2) / 5)


def test_smooth_boundary_has_exponent_1():
    exponent, share = dynamics.uncertainty_exponent(halves(200))
    assert exponent == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose(share[:3], [0.01, 0.02, 0.03])


def test_exponent_and_entropy_of_fractal_boundary_equal_attractors_jl():
    def grebogi(x, p):
        angle = x[0] + 1.32 * jnp.sin(2 * x[0]) - 0.9 * jnp.sin(4 * x[0]) - x[1] * jnp.sin(x[0])
        return jnp.stack([angle, -0.3 * jnp.cos(x[0])])

    box = Box([0, -0.5], [2 * np.pi, 0.5], [300, 300], ["periodic", "sink"])
    basins = dynamics.basins(grebogi, box)
    assert basins.attractors == 2
    np.testing.assert_allclose(basins.fraction, 0.5, atol=0.01)
    assert 0.15 < dynamics.uncertainty_exponent(basins, (3, 5, 8, 11, 15))[0] < 0.3
    whole, mixed = dynamics.basin_entropy(basins, 6)
    assert 0.39 < whole < 0.43
    assert 0.59 < mixed < 0.62


def test_overlap_of_a_basin_with_itself_is_1(basins):
    np.testing.assert_allclose(dynamics.overlap(basins, basins), np.eye(2))
    other = dynamics.basins(lambda x, p: x, Box([0], [1], [2]))
    with pytest.raises(ValueError, match="the same box"):
        dynamics.overlap(basins, other)


def test_attractors_are_matched_by_place():
    def well(x, p):
        # Fixed points at 0.2 and at 0.8, the second only from p = 1 on.
        return jnp.where((x > 0.5) & (p["p"] >= 1), 0.8, 0.2) + 0.01 * p["p"]

    continued = dynamics.continuation(well, Box([0], [1], [50]), {"p": np.array([0, 1, 2, 0, 1.0])})
    assert [sorted(names.tolist()) for names in continued.label] == [
        [0],
        [0, 1],
        [0, 1],
        [0],
        [0, 1],
    ]
    assert continued.appears.tolist() == [0, 1]
    assert continued.vanishes.tolist() == [4, 4]
    np.testing.assert_allclose(continued.fraction[0], [1, 0])


def test_changes_of_attractors_are_reported():
    def steps(x, p):
        # To 0.1, 0.5 and 0.9; the attractor at 0.9 vanishes first, then that at 0.1.
        left = jnp.where(x < 0.7, 0.5, jnp.where(p["p"] >= 1, 0.5, 0.9))
        return jnp.where(x < 0.3, jnp.where(p["p"] >= 2, 9.0, 0.1), left)

    continued = dynamics.continuation(steps, Box([0], [1], [50]), {"p": np.array([0, 1, 2.0])})
    first = continued.members[0].basin
    middle, right, left = (int(continued.label[0][first[cell]]) for cell in (25, 45, 5))
    assert continued.vanishes[[middle, right, left]].tolist() == [2, 0, 1]
    assert continued.merges[[middle, right, left]].tolist() == [-1, middle, -1]


@pytest.mark.parametrize("by", ["cells", "orbits"])
def test_batch_of_parameters_equals_one_by_one(by):
    def well(x, p):
        return x + p["rate"] * (x - x**3) + p["shift"]

    box, rates = Box([-2], [2], [41]), [0.1, 0.3, 0.9]
    continued = dynamics.continuation(well, box, {"rate": rates, "shift": 0.01}, by=by)
    for member, rate in zip(continued.members, rates, strict=True):
        alone = dynamics.basins(well, box, {"rate": rate, "shift": 0.01}, by=by)
        assert (member.image == alone.image).all()
        assert (member.basin == alone.basin).all()
        assert (member.step == alone.step).all()
        np.testing.assert_allclose(member.orbit, alone.orbit)


def test_attractor_across_a_periodic_axis_is_matched():
    def ring(x, p):
        # The ring is at 0.47, and points above 0.5 leave; then it is at 0.53, and attracts all.
        lost = (p["p"] < 1) & (x[1] > 0.5)
        return jnp.stack([x[0] + 0.31 + 0.02 * p["p"], jnp.where(lost, 9.0, 0.47 + 0.06 * p["p"])])

    box = Box([0, 0], [1, 1], [10, 10], ["periodic", "sink"])
    continued = dynamics.continuation(ring, box, {"p": [0.0, 1.0]})
    assert [names.tolist() for names in continued.label] == [[0], [0]]


@pytest.mark.parametrize("params", [{"a": 1.0}, {"a": [1.0, 2.0], "b": [1.0]}])
def test_parameters_of_unequal_length_are_refused(params):
    with pytest.raises(ValueError, match="params: expected"):
        dynamics.continuation(lambda x, p: x, Box([0], [1], [2]), params)


def turned(rate):
    """The section through a spiral whose radius falls by `exp(-rate)` in a turn of time 2 pi."""
    fall = rate / (2 * np.pi)
    return dynamics.section(
        lambda x, p: jnp.array([-fall * x[0] - x[1], x[0] - fall * x[1]]),
        lambda x, p: x[1],
        lift=lambda u, p: jnp.array([u[0], 0.0]),
        project=lambda x, p: x[:1],
        dt=0.1,
    )


@pytest.mark.parametrize(
    ("map", "duration"),
    [
        (dynamics.flow(lambda x, p: -0.06 * x, 0.05, 10), 0.5),
        (turned(0.03), 2 * np.pi),
        (lambda x, p: jnp.exp(-0.03) * x, None),
    ],
    ids=["flow", "section", "map"],
)
def test_times_of_slow_decay_are_logarithms_though_cells_stay_where_they_are(map, duration):
    box, width = Box([0], [1], [30]), 1 / 30
    most = int(np.log(1 / width) / 0.03) + 1
    # The sum over n of the share of starts farther than `width * exp(0.03 n)`.
    truth = most - width * np.expm1(0.03 * most) / np.expm1(0.03)
    basins = dynamics.basins(map, box)
    assert (basins.attractors, basins.fraction.tolist()) == (1, [1.0])
    assert basins.groups > 10
    assert 0 < basins.mean_steps_error[0] < 0.05 * truth
    np.testing.assert_allclose(basins.mean_steps, truth, atol=4 * basins.mean_steps_error[0])
    if duration is None:
        assert basins.mean_time is None
    else:
        np.testing.assert_allclose(basins.mean_time, duration * basins.mean_steps, rtol=1e-4)
    orbits = dynamics.basins(map, box, by="orbits")
    np.testing.assert_allclose(orbits.mean_steps, truth, atol=0.5)
    assert orbits.mean_steps_error == orbits.step[0] == 0


def test_mean_of_orbits_that_are_followed_for_too_short_is_unknown():
    basins = dynamics.basins(lambda x, p: (1 - 1e-5) * x, Box([-1], [1], [31]))
    # Orbits from afar need more mappings than are followed.
    assert np.isnan([basins.mean_steps[-1], basins.mean_steps_error[-1]]).all()
