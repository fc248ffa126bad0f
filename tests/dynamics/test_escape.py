"""Times until noisy systems leave, compared with quadrature, Nystrom's method and matrices."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.stats import norm

from jaxcell import dynamics, markov
from jaxcell.space import Box


WELL = dynamics.flow(lambda x, p: p["a"] * x - p["b"] * x**3 + p["c"], dt=0.05)
STANDARD = {"a": 1.0, "b": 1.0, "c": 0.0}


def exact(params, noise, low, high, reflects, start):
    """Integrate the mean and the deviation of the time to leave, and the probability of `high`."""
    x = np.linspace(low, high, 4001)

    def along(values):
        return cumulative_simpson(values, x=x, initial=0)

    force = params["a"] * x - params["b"] * x**3 + params["c"]
    power = along(force) / (noise**2 / 2)
    power -= power[np.abs(x - start).argmin()]
    scale = along(np.exp(-power))

    def summed(gain):
        both = along(np.exp(-power) * along(gain * np.exp(power)) / (noise**2 / 2))
        return both[-1] - both if reflects else scale / scale[-1] * both[-1] - both

    mean = summed(np.ones_like(x))
    second = summed(2 * mean)
    at = [float(np.interp(start, x, one)) for one in (mean, second, scale / scale[-1])]
    return at[0], (at[1] - at[0] ** 2) ** 0.5, 1.0 if reflects else at[2]


# Published mean times, to five digits.
@pytest.mark.parametrize(("noise", "known"), [(0.6, 9.3769), (0.5, 18.4262), (0.4, 57.478)])
def test_time_to_the_top_of_the_barrier(noise, known):
    box = Box([-3], [1], [100], "clamp")
    found = dynamics.escape(
        WELL, box, STANDARD, noise=noise, start=[-1], into=lambda x: x[:, 0] >= 0
    )
    assert abs(found.mean_time - known) < found.mean_time_error < 0.02 * known
    mean, deviation, _ = exact(STANDARD, noise, -3, 0, True, -1)
    assert mean == pytest.approx(known, rel=1e-4)
    assert abs(found.deviation - deviation) < found.deviation_error < 0.02 * deviation
    assert found.answer[0].startswith(f"It stays {found.mean_time:.2g}"[:10])


@pytest.mark.parametrize(("half", "known"), [(1.5, 5.7265), (2.0, 27.4327)])
def test_exit_of_an_ornstein_uhlenbeck_process(half, known):
    found = dynamics.escape(
        dynamics.flow(lambda x, p: -x, dt=0.1), Box([-half], [half], [60]), noise=1.0, start=[0]
    )
    assert abs(found.mean_time - known) < found.mean_time_error < 0.02 * known
    assert found.end == ("below x0", "above x0")
    np.testing.assert_allclose(found.probability, 0.5)


def test_brownian_motion_leaves_a_disc_by_its_harmonic_measure():
    found = dynamics.escape(
        dynamics.flow(lambda x, p: 0 * x, dt=0.1),
        Box([-1.1, -1.1], [1.1, 1.1], [41, 40]),
        noise=0.7,
        start=[0.2, 0.3],
        into={
            "up": lambda x: (np.hypot(*x.T) >= 1) & (x[:, 1] > 0),
            "down": lambda x: (np.hypot(*x.T) >= 1) & (x[:, 1] <= 0),
        },
    )
    assert found.end[:2] == ("up", "down")
    radius = 0.2**2 + 0.3**2
    up = 0.5 + np.arctan(2 * 0.3 / (1 - radius)) / np.pi
    assert abs(found.probability[0] - up) < found.probability_error[0] < 0.03
    time = (1 - radius) / (2 * 0.7**2)
    assert abs(found.mean_time - time) < found.mean_time_error < 0.03 * time
    # The first zero of Bessel's function determines the rate.
    assert abs(found.rate - 0.7**2 * 2.404826**2 / 2) < found.rate_error


WELLS = 40


@pytest.mark.parametrize("seed", range(5))
def test_errors_of_random_wells_are_below_their_estimates(seed):
    """Compares 200 wells in all, each by its mean time, its deviation and a probability."""
    rng, held = np.random.default_rng(seed), []
    while len(held) < WELLS:
        if rng.random() < 0.5:
            params = {"a": -rng.uniform(0.5, 2), "b": 0.0, "c": rng.uniform(-0.5, 0.5)}
        else:
            params = {"a": rng.uniform(0.5, 1.5), "b": rng.uniform(0.5, 1.5), "c": 0.1}
        noise, low, high = rng.uniform([0.3, -2.5, 0.2], [1.0, -1.3, 2.0])
        reflects, start = bool(rng.random() < 0.5), rng.uniform(0.7 * low, high - 0.15)
        mean, deviation, arrives = exact(params, noise, low, high, reflects, start)
        # The quadrature itself loses as many digits as the time has.
        if not mean < 1e8:
            continue
        cells = int(rng.choice([30, 60, 100]))
        # The boundary of the region is anywhere in a cell.
        end = high + rng.uniform(0.3, 1.0) if reflects else high
        found = dynamics.escape(
            WELL,
            Box([low], [end], [cells], "clamp" if reflects else "sink"),
            params,
            noise=noise,
            start=[start],
            into=(lambda x, high=high: x[:, 0] >= high) if reflects else None,
        )
        held.append(
            [
                abs(found.mean_time - mean) <= found.mean_time_error,
                abs(found.deviation - deviation) <= found.deviation_error,
                abs(found.probability[-1] - arrives) <= found.probability_error[-1] + 1e-7,
            ]
        )
    assert (np.mean(held, axis=0) >= 0.95).all()


def test_error_of_a_probability_holds_where_differences_vanish():
    # Near some start, chains with both widths have the same probability by chance.
    params, held = {"a": -1.0, "b": 0.0, "c": 0.3}, []
    for start in np.linspace(-0.8, 0.8, 17):
        _, _, known = exact(params, 0.7, -1.3, 1.7, False, start)
        found = dynamics.escape(
            WELL, Box([-1.3], [1.7], [30], "sink"), params, noise=0.7, start=[start]
        )
        held.append(abs(found.probability[-1] - known) <= found.probability_error[-1])
        share = found.probability[-1] * (1 - found.probability[-1])
        relative = found.mean_time_error / found.mean_time
        assert found.probability_error[-1] >= 0.99 * relative * share
    assert all(held)


def test_a_region_that_is_left_after_one_mapping_for_certain():
    box = Box([-1], [1], [20], "clamp")
    found = dynamics.escape(
        lambda x, p: 0 * x + 0.9, box, noise=0.0, start=[0.0], into=lambda x: x[:, 0] > 0.5
    )
    assert (found.mean_time, found.deviation, found.deviation_error) == (1, 0, 0)


def legendre(low, high, count):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return low + (nodes + 1) * (high - low) / 2, weights * (high - low) / 2


@pytest.mark.parametrize("noise", [0.25, 0.3, 0.4, 0.5])
@pytest.mark.parametrize("box", [Box([-3], [2], [200], "clamp"), Box([-4], [2.5], [220], "clamp")])
def test_time_to_extinction_of_a_ricker_population(noise, box):
    # Logarithms of the population; it is extinct below 0.05, and may grow without bound.
    nodes, weights = legendre(np.log(0.05), 3, 400)
    image = nodes + 1.5 * (1 - np.exp(nodes))
    kernel = norm.pdf(nodes, image[:, None], noise) * weights
    times = np.linalg.solve(np.eye(nodes.size) - kernel, np.ones(nodes.size))
    found = dynamics.escape(
        lambda x, p: x + p["r"] * (1 - jnp.exp(x)),
        box,
        {"r": 1.5},
        noise=noise,
        start=[0.0],
        into=lambda x: x[:, 0] < np.log(0.05),
    )
    known = np.interp(0, nodes, times)
    assert abs(found.mean_time - known) < found.mean_time_error < 0.1 * known
    assert found.mean_time == pytest.approx(known, rel=0.01)
    # A large population starves: the next one has 1.5 (1 - exp(x)) more.
    assert 1.2 < found.path[-1, 0] < 1.5
    assert f"the most probable path, from {found.path[-1, 0]:.3g}." in found.answer[1]
    # The place of the last mapping: visits to it, times the probability of extinction.
    begin = norm.pdf(nodes, 0, noise) * weights
    visits = np.linalg.solve(np.eye(nodes.size) - kernel.T, begin)
    leaves = (visits * norm.cdf(np.log(0.05), image, noise)).cumsum()
    low, high = np.interp([0.05, 0.95], leaves / leaves[-1], nodes)
    said = re.search(r"90 % of the runs leave from x0 = (\S+) to (\S+);", found.answer[1])
    width = found.box.width[0]
    np.testing.assert_allclose([float(one) for one in said.groups()], [low, high], atol=width)
    shares = found.departure.cumsum()
    assert shares[-1] == pytest.approx(1, rel=1e-9)
    np.testing.assert_allclose(
        np.interp([0.05, 0.95], shares, found.box.ticks(0) + width / 2), [low, high], atol=width / 2
    )


def test_law_of_a_flow_is_that_of_the_matrix_exponential():
    found = dynamics.escape(WELL, Box([-2], [1.6], [60]), STANDARD, noise=0.6, start=[-0.9])
    known = []
    for cells in (60, 40):
        box = Box([-2], [1.6], [cells])
        one = dynamics.diffusion(WELL, box, STANDARD, noise=0.6)
        rates = one.chain.to_scipy().toarray()[:cells, :cells] - np.eye(cells)
        rates = rates / float(one.duration)
        at = np.interp([-0.9], box.ticks(0), np.arange(cells))[0]
        start = np.zeros(cells)
        start[[int(at), int(at) + 1]] = 1 - at % 1, at % 1

        def left(time, share, start=start, rates=rates):
            return (start @ expm(time * rates)).sum() - (1 - share)

        within = [brentq(left, 0, 1000, args=(share,), rtol=1e-12) for share in found.share]
        values, vectors = np.linalg.eig(rates.T)
        slowest = np.argmax(values.real)
        known.append(np.log([*within, -values[slowest].real]))
        if cells == 60:
            quasi = vectors[:, slowest].real
            np.testing.assert_allclose(found.quasi_stationary, quasi / quasi.sum(), atol=1e-9)
    # Both are extrapolated to cells without width.
    extrapolated = np.exp(known[0] + (known[0] - known[1]) / (1.5**2 - 1))
    np.testing.assert_allclose([*found.within, found.rate], extrapolated, rtol=1e-6)
    assert found.rate_error > 0


def test_law_of_a_map_is_that_of_its_first_passages():
    box = Box([-2], [2], [100], "clamp")
    target = np.abs(box.ticks(0)) > 1.2
    found = dynamics.escape(lambda x, p: -0.9 * x, box, noise=0.4, start=[0.1], into=target)
    one = dynamics.chain(lambda x, p: -0.9 * x, box, noise=0.4)
    weights = np.zeros(100)
    at = np.interp(0.1, box.ticks(0), np.arange(100))
    weights[[int(at), int(at) + 1]] = 1 - at % 1, at % 1
    law = np.asarray(markov.first_passage(one, weights, target, 2000))
    steps = np.arange(law.size)
    assert found.mean_time == pytest.approx(law @ steps, rel=1e-6)
    assert found.deviation == pytest.approx(np.sqrt(law @ steps**2 - (law @ steps) ** 2), rel=1e-6)
    known = np.interp(found.share, np.cumsum(law), steps)
    np.testing.assert_allclose(found.within, known, rtol=1e-3)


def test_law_of_a_very_rare_event_is_exponential():
    # The depth of the well is 0.25, so that the time grows as exp(0.5 / noise^2).
    found = dynamics.escape(
        WELL,
        Box([-2], [0.5], [500], "clamp"),
        STANDARD,
        noise=0.03,
        start=[-1],
        into=lambda x: x[:, 0] >= 0,
    )
    known = np.pi / np.sqrt(2) * np.exp(0.5 / 0.03**2)
    assert known > 1e241
    assert found.mean_time == pytest.approx(known, rel=0.02)
    assert found.mean_time_error < 0.05 * known
    assert found.deviation == pytest.approx(found.mean_time, rel=1e-6)
    np.testing.assert_allclose(found.within, -found.mean_time * np.log(1 - found.share), rtol=1e-6)


def test_start_in_the_long_run_leaves_at_a_constant_rate():
    box = Box([-2], [1.6], [60])
    found = dynamics.escape(WELL, box, STANDARD, noise=0.6)
    assert found.start is None
    assert found.mean_time * found.rate == pytest.approx(1, rel=1e-6)
    assert found.deviation == pytest.approx(found.mean_time, rel=1e-6)
    np.testing.assert_allclose(found.within * found.rate, -np.log(1 - found.share), rtol=1e-6)


def test_most_probable_path_follows_the_valley():
    # Two wells with the energy (x^2 - 1)^2 / 4 + (y - x^2 / 2)^2, and a bent valley between them.
    def field(x, p):
        apart = x[1] - x[0] ** 2 / 2
        return jnp.stack([x[0] - x[0] ** 3 + 2 * x[0] * apart, -2 * apart])

    found = dynamics.escape(
        dynamics.flow(field, dt=0.05),
        Box([-1.5, -0.5], [1.5, 1.0], [30, 30], "clamp"),
        noise=0.1,
        start=[-1, 0.5],
        into=lambda x: np.hypot(x[:, 0] - 1, x[:, 1] - 0.5) < 0.2,
    )
    x, y = found.path.T
    np.testing.assert_allclose(found.path[0], [-1, 0.5], atol=0.06)
    assert np.abs(y - x**2 / 2).max() < 0.2
    assert (np.abs(np.diff(found.path, axis=0)) < [0.11, 0.06]).all()


def test_leaving_a_basin_is_entering_the_rest():
    box = Box([-2], [2], [80], "clamp")
    basins = dynamics.basins(WELL, box, STANDARD)
    left = int(basins.basin[20])
    options = {"noise": 0.5, "start": [-1]}
    one = dynamics.escape(WELL, box, STANDARD, out_of=basins.basin == left, **options)
    other = dynamics.escape(WELL, box, STANDARD, into=lambda x: x[:, 0] >= 0, **options)
    assert one.mean_time == pytest.approx(other.mean_time, rel=1e-6)
    assert one.end == ("outside",)


@pytest.mark.parametrize("start", [[-0.9], None])
@pytest.mark.parametrize("kind", ["flow", "map"])
def test_elasticities_equal_differences(kind, start):
    map = WELL if kind == "flow" else lambda x, p: WELL.one(x, p)
    noise, box = (
        (0.5, Box([-2], [1], [50], "clamp"))
        if kind == "flow"
        else (0.15, Box([-2], [1], [60], "clamp"))
    )

    def run(params, factor=1.0, gradient=False):
        return dynamics.escape(
            map,
            box,
            params,
            noise=factor * noise,
            start=start,
            into=lambda x: x[:, 0] >= 0.013,
            gradient=gradient,
        )

    found, step = run(STANDARD, gradient=True), 1e-4
    assert found.cause == ("a", "b", "c", "noise")
    for k, name in enumerate(found.cause):
        change = {"factor": 1.0} if name == "noise" else {}
        ends = []
        for sign in (-1, 1):
            moved = (
                {**STANDARD, name: STANDARD.get(name, 0) + sign * step} if not change else STANDARD
            )
            ends.append(run(moved, 1 + sign * step if change else 1.0).mean_time)
        slope = (ends[1] - ends[0]) / (2 * step)
        assert found.derivative[k] == pytest.approx(slope, rel=1e-4)
        value = STANDARD.get(name, 1.0)
        assert found.elasticity[k] == pytest.approx(
            slope * value / found.mean_time, rel=1e-4, abs=1e-9
        )
    assert "1 % more noise" in found.answer[-1]


@pytest.mark.parametrize("used", [True, False])
def test_a_parameter_may_be_called_noise(used):
    found = dynamics.escape(
        WELL,
        Box([-2], [1], [50], "clamp"),
        {**STANDARD, "noise": 0.5},
        noise=(lambda x, p: p["noise"] + 0 * x) if used else 0.5,
        start=[-0.9],
        into=lambda x: x[:, 0] >= 0.013,
        gradient=True,
    )
    assert found.cause == ("a", "b", "c", "noise", "noise_factor")
    each = [exact(STANDARD, 0.5 * ratio, -2, 0.013, True, -0.9)[0] for ratio in (1.001, 0.999)]
    known = np.log(each[0] / each[1]) / 0.002
    of_parameter, of_factor = found.elasticity[-2:]
    assert abs(of_factor - known) < found.elasticity_error[-1] < 0.05 * abs(known)
    assert of_parameter == pytest.approx(of_factor if used else 0, rel=1e-9)


@pytest.mark.parametrize("start", [[-1], None])
def test_elasticities_of_a_very_rare_event(start):
    found = dynamics.escape(
        WELL,
        Box([-2], [0.5], [120], "clamp"),
        STANDARD,
        noise=0.05,
        start=start,
        into=lambda x: x[:, 0] >= 0,
        gradient=True,
    )
    # The time is pi / sqrt(2) / a * exp(a^2 / (2 b noise^2)), for weak noise.
    assert found.mean_time > 1e86
    np.testing.assert_allclose(found.elasticity, [399, -200, 0, -400], rtol=1e-4, atol=1e-9)


def test_functions_may_be_of_a_point_alone():
    box = Box([-1], [1], [40])

    def run(noise, **options):
        return dynamics.escape(lambda x: x / 2, box, noise=noise, start=[0], **options).mean_time

    assert run(lambda x: 0.4 + 0 * x, gradient=True) == pytest.approx(run(0.4), rel=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "into: expected a region where the system ends"),
        ({"into": [70]}, "cell 70"),
        ({"into": [3], "start": [-1.8]}, "start: the point .* in the region target"),
        ({"into": [3], "start": [0.0, 0.0]}, "start: expected 1 coordinates"),
        ({"into": [3], "samples": 8}, "options: a flow has none, got samples"),
        ({"into": {"a": [3], "b": [2, 3]}}, "into: 'a' and 'b' overlap, as at"),
        ({"into": lambda x: x[:, 0] < 5}, "into: the centre of every cell is in a region"),
        ({"into": [3], "noise": 0.0}, "into: cannot be reached from"),
        ({"into": lambda x: x[:, 0] > 9}, "into: no cell of the box is in a region"),
        ({"into": [3], "start": [-5.0]}, r"start: the point .* outside of the box, from \(-2.0"),
        ({"into": [3], "start": [0.5]}, "start: the point .* outside of the box"),
        ({"into": [3], "noise": (0.3, 0.2)}, "noise: expected one number, or one for each axis"),
        ({"into": [3], "params": {**STANDARD, "b": np.nan}}, "params: b: expected a number"),
    ],
)
def test_wrong_arguments_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        dynamics.escape(
            WELL,
            Box([-2], [0], [30], "clamp"),
            **{"params": STANDARD, "noise": 0.3, **options},
        )
