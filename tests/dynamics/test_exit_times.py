"""Mean times along a parameter, compared with matrices of differences of normal distributions."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxcell import dynamics, study
from jaxcell.dynamics.noise import exit_times as module
from jaxcell.space import Box


NOISE = 0.35, 0.5
# Values of a Gaussian at points a step apart, whose differences give a derivative.
STEP = 1e-3
AROUND = np.array([1, -8, 0, 8, -1]) / (12 * STEP)


def system(axes, cells, name="a"):
    """Map each cell from its centre, so that its sample points do not matter."""
    box = Box([-2.0, -2.0], [2.0, 2.0], [cells, cells], axes)
    width = 4 / cells

    def wells(x, p):
        x = (jnp.floor((x + 2) / width) + 0.5) * width - 2
        return jnp.stack([x[0] + 0.3 * (p[name] * x[0] - x[0] ** 3) + 0.1 * x[1], 0.5 * x[1]])

    return dynamics.System(wells, box, {name: 1.0})


def along(image, noise, cells, kind):
    faces = np.linspace(-2, 2, cells + 1)
    if kind == "periodic":
        return sum(along(image + 4 * k, noise, cells, "sink") for k in range(-3, 4))
    below = norm.cdf((faces - image[:, None]) / noise)
    if kind == "clamp":
        below[:, 0], below[:, -1] = 0, 1
    return np.diff(below, axis=1)


def dense(a, axes, cells, noise=NOISE):
    """Solve for the mean time until x > 0 or outside, from the mean of four cells at (-1, 0)."""
    centre = (np.arange(cells) + 0.5) * 4 / cells - 2
    x, y = (each.ravel() for each in np.meshgrid(centre, centre, indexing="ij"))
    first = along(x + 0.3 * (a * x - x**3) + 0.1 * y, noise[0], cells, axes[0])
    second = along(0.5 * y, noise[1], cells, axes[1])
    matrix = (first[:, :, None] * second[:, None]).reshape(x.size, x.size)
    inside = x < 0
    step = matrix[np.ix_(inside, inside)]
    time = np.linalg.solve(np.eye(len(step)) - step, np.ones(len(step)))
    near = (np.abs(x[inside] + 1) < 4 / cells) & (np.abs(y[inside]) < 4 / cells)
    assert near.sum() == 4
    return time[near].mean()


def left(points):
    return points[:, 0] > 0


@pytest.mark.parametrize(
    "axes", [("clamp", "clamp"), ("sink", "clamp"), ("clamp", "periodic"), ("sink", "sink")]
)
def test_times_and_derivatives_are_those_of_dense_matrices(axes):
    values = np.linspace(0.9, 1.1, 4)
    found = dynamics.exit_times(
        system(axes, 12), "a", values, noise=NOISE, start=[-1, 0], into=left
    )
    expected = [[dense(a + k * STEP, axes, 12) for k in range(-2, 3)] for a in values]
    np.testing.assert_allclose(found.mean_time, np.array(expected)[:, 2], rtol=1e-9)
    np.testing.assert_allclose(found.derivative, expected @ AROUND, rtol=1e-6)
    assert not found.alone.any()
    assert found.residual.max() < 1e-7


def drift(x, p):
    return x + 0.3 * (p["a"] * x - x**3)


def in_continuous_space(a, noise):
    """Solve the integral equation of the mean time until x > 0 from -1, by Nystrom's method."""
    node, rule = np.polynomial.legendre.leggauss(120)
    x, rule = 1.5 * (node - 1), 1.5 * rule
    step = norm.pdf(x, drift(x, {"a": a})[:, None], noise) * rule
    first = norm.pdf(x, drift(-1.0, {"a": a}), noise) * rule
    return 1 + first @ np.linalg.solve(np.eye(x.size) - step, np.ones(x.size))


def test_numbers_are_those_of_escape_and_of_an_integral_equation():
    noise, values = 0.25, np.array([0.9, 1.0, 1.07])
    well = dynamics.System(drift, Box([-2.0], [2.0], [60], "clamp"), {"a": 1.0})
    about = {"noise": noise, "start": [-1], "into": left}
    found = dynamics.exit_times(well, "a", values, **about)
    known = np.array(
        [[in_continuous_space(a + k * STEP, noise) for k in range(-2, 3)] for a in values]
    )
    for number, error, true in (
        (found.mean_time, found.mean_time_error, known[:, 2]),
        (found.derivative, found.derivative_error, known @ AROUND),
    ):
        assert (abs(number - true) < error).all()
        assert (error < 0.2 * true).all()
        # The chain of the box is 2 to 4 % off.
        np.testing.assert_allclose(number, true, rtol=4e-3)
    for k, a in enumerate(values):
        one = dynamics.escape(well, params={"a": a}, gradient=True, **about)
        assert found.mean_time[k] == pytest.approx(one.mean_time, rel=1e-9)
        assert found.mean_time_error[k] == pytest.approx(one.mean_time_error, rel=0.02)
        assert found.derivative[k] == pytest.approx(one.derivative[0], rel=1e-8)
        assert found.derivative_error[k] == pytest.approx(one.derivative_error[0], rel=0.02)


def test_derivatives_that_are_not_finite_are_counted():
    line = dynamics.System(
        lambda x, p: 0.5 * x + jnp.sqrt(p["b"]), Box([-2.0], [2.0], [20], "clamp"), {"b": 0.0}
    )
    about = {"noise": 0.5, "start": [-1], "into": left}
    with pytest.warns(UserWarning, match="derivative: not finite for 1 of 2 values of the param"):
        found = dynamics.exit_times(line, "b", [0.0, 0.25], **about)
    assert np.isfinite(found.mean_time).all()
    assert np.isfinite(found.derivative).tolist() == [False, True]


def test_a_region_in_the_last_cell_has_all_beyond_the_clamped_side():
    cells, noise = 40, 0.3
    box, width = Box([-2.0], [2.0], [cells], "clamp"), 0.1
    line = dynamics.System(
        lambda x, p: p["a"] * ((jnp.floor((x + 2) / width) + 0.5) * width - 2), box, {"a": 0.8}
    )
    found = dynamics.exit_times(
        line, "a", [0.8, 0.9], noise=noise, start=[0.0], into=lambda x: x[:, 0] < -1.95
    )

    def mean(a):
        centre = (np.arange(cells) + 0.5) * width - 2
        step = along(a * centre, noise, cells, "sink")
        # Half of the first cell is in the region; beyond the other side is the last cell.
        step[:, 0] /= 2
        step[:, -1] += norm.sf((2 - a * centre) / noise)
        time = np.linalg.solve(np.eye(cells) - step, np.ones(cells))
        return time[cells // 2 - 1 : cells // 2 + 1].mean()

    np.testing.assert_allclose(found.mean_time, [mean(0.8), mean(0.9)], rtol=1e-8)


def test_rare_exits_have_six_digits():
    noise, cells = 0.1, 32
    centre = (np.arange(cells) + 0.5) * 4 / cells - 2
    box, width = Box([-2.0], [2.0], [cells], "clamp"), 4 / cells

    def well(x, p):
        x = (jnp.floor((x + 2) / width) + 0.5) * width - 2
        return x + 0.4 * (p["a"] * x - x**3)

    def exact(a):
        """Eliminate cells without a subtraction, and take the mean time from two cells."""
        here = centre[: cells // 2]
        image = here + 0.4 * (a * here - here**3)
        step = along(image, noise, cells, "clamp")[:, : here.size]
        leaving = norm.sf(-image / noise)
        time, on = np.ones(here.size), leaving.copy()
        for k in range(here.size - 1, -1, -1):
            on[k] = leaving[k] + step[k, :k].sum()
            share = step[:k, k] / on[k]
            step[:k, :k] += share[:, None] * step[k, :k]
            leaving[:k] += share * leaving[k]
            time[:k] += share * time[k]
        for k in range(here.size):
            time[k] = (time[k] + step[k, :k] @ time[:k]) / on[k]
        return time[cells // 4 - 1 : cells // 4 + 1].mean()

    found = dynamics.exit_times(
        dynamics.System(well, box, {"a": 1.0}), "a", [1.05], noise=noise, start=[-1], into=left
    )
    expected = [exact(1.05 + k * STEP) for k in range(-2, 3)]
    middle, slope = expected[2], expected @ AROUND
    assert middle > 1e8
    assert not found.alone.any()
    assert found.mean_time[0] == pytest.approx(middle, rel=1e-6)
    assert found.derivative[0] == pytest.approx(slope, rel=1e-6)


def test_members_that_cannot_be_interpolated_are_computed_alone():
    box = Box([-2.0], [2.0], [20], "clamp")

    def jumps(x, p):
        return x + 0.3 * (x - x**3) + 0.1 * jnp.floor(p["a"])

    about = {"noise": 0.4, "start": [-1], "into": left}
    one = dynamics.System(jumps, box, {"a": 0.5})
    found = dynamics.exit_times(one, "a", [0.5, 0.9999], **about)
    assert found.alone.tolist() == [False, True]
    expected = dynamics.escape(one, params={"a": 0.9999}, **about)
    assert found.mean_time[1] == expected.mean_time
    assert found.mean_time[0] == pytest.approx(expected.mean_time, rel=1e-9)
    np.testing.assert_allclose(found.derivative, 0, atol=1e-20)


def test_deeper_wells_are_solved_without_subtractions():
    box = Box([-2.0], [2.0], [40], "clamp")
    well = dynamics.System(lambda x, p: x + 0.3 * (p["a"] * x - x**3), box, {"a": 1.0})
    about = {"noise": 0.06, "start": [-1], "into": left}
    found = dynamics.exit_times(well, "a", [1.0], **about)
    expected = dynamics.escape(well, **about)
    assert expected.mean_time > 1e13
    assert found.mean_time[0] == pytest.approx(expected.mean_time, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "b"}, "name: expected one of a, got 'b'"),
        ({"values": [np.nan]}, "values: expected finite numbers, one for each member"),
        ({"noise": 0.0}, "noise: expected 2 numbers above 0, got 0.0"),
        ({"into": None}, "into: expected a region where the system ends"),
        ({"start": [1, 0]}, "is in the region target"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    about = {"name": "a", "values": [1.0], "noise": NOISE, "start": [-1, 0], "into": left}
    with pytest.raises(ValueError, match=message):
        dynamics.exit_times(system("clamp", 12), **{**about, **change})


def test_a_map_without_finite_numbers_in_a_cell_is_refused_with_its_parameters():
    root = dynamics.System(
        lambda x, p: jnp.sqrt(x + p["c"]) - 1, Box([-2.0], [2.0], [20], "clamp"), {"c": 2.5}
    )
    about = {"noise": 0.3, "start": [0.0], "into": lambda x: x[:, 0] > 0.8}
    for c in (-3.0, 1.9):
        with pytest.raises(ValueError, match=rf"map: expected finite numbers.*'c': {c}"):
            dynamics.exit_times(root, "c", [2.2, c], **about)
    with pytest.raises(ValueError, match=r"map: expected finite numbers.*'c': 1.9"):
        dynamics.escape(root, params={"c": 1.9}, **about)
    with pytest.raises(ValueError, match="map: expected finite numbers"):
        dynamics.escape(root, params={"c": -3.0}, **about)
    # A region may be where the map has no numbers.
    about["into"] = lambda x: x[:, 0] < -1
    assert dynamics.exit_times(root, "c", [1.9], **about).mean_time > 1


def test_a_flow_is_refused():
    flow = dynamics.System(
        dynamics.flow(lambda x, p: p["a"] * x - x**3, dt=0.1),
        Box([-2], [2], [20], "clamp"),
        {"a": 1.0},
    )
    with pytest.raises(ValueError, match="system: expected a map with noise once per mapping"):
        dynamics.exit_times(flow, "a", [1.0], noise=0.5, start=[-1], into=left)


def test_members_of_a_sweep_are_those_of_single_studies(tmp_path, monkeypatch):
    file = tmp_path / "wells.py"
    file.write_text(
        "from jaxcell.dynamics import System\n"
        "from jaxcell.space import Box\n"
        "box = Box([-2.0], [2.0], [30], 'clamp')\n"
        "well = System(lambda x, p: x + 0.3 * (p['a'] * x - x**3), box, {'a': 1.0})\n"
    )
    one = study.Escape(
        system=f"{file}:well",
        noise=(0.4,),
        start=(-1.0,),
        into=("x>0",),
        gradient=True,
        params=("a=0.8",),
    )
    values = np.linspace(0.8, 1.2, 5)
    names = "mean_time", "d_mean_time_d_a"
    alone = [
        dataclasses.replace(one, params=(f"a={a}",)).numbers({}, names.__contains__)
        for a in values[[0, 3]]
    ]
    monkeypatch.setattr(module, "escape", None)
    found = one.numbers({"params_a": values}, names.__contains__)
    # Members do not depend on the other members of a batch.
    again = one.numbers({"params_a": values[3:]}, names.__contains__)
    both = one.numbers({"params_a": values}, ("share_0", "mean_time").__contains__)
    assert both["mean_time"][1].tolist() == found["mean_time"][1].tolist()
    for a, share in zip(values, both["share_0"][1], strict=True):
        matrix = dynamics.chain(one.chosen.map, one.chosen.box, {"a": a}, noise=0.4).to_scipy()
        limit = np.linalg.matrix_power(matrix.toarray(), 1 << 12).mean(axis=0)
        assert share == pytest.approx(limit[15:].sum(), abs=2e-7)
    for more in ("mean_time_error", "deviation"):
        with_more = one.numbers({"params_a": values}, ("mean_time", more).__contains__)
        np.testing.assert_allclose(with_more["mean_time"][1], found["mean_time"][1], rtol=1e-9)
    assert set(found) == set(names)
    for name in names:
        expected = [float(numbers[name][1]) for numbers in alone]
        np.testing.assert_allclose(found[name][1][[0, 3]], expected, rtol=1e-8)
        assert found[name][1][3:].tolist() == again[name][1].tolist()


@pytest.mark.parametrize("axes", [("clamp", "clamp"), ("clamp", "periodic")])
def test_shares_of_regions_in_the_long_run_are_those_of_dense_matrices(axes):
    cells, values = 12, np.linspace(0.9, 1.1, 4)
    regions = {"right": left, "corner": lambda x: (x[:, 0] < 0) & (x[:, 1] > 1.2)}
    found = dynamics.exit_times(
        system(axes, cells), "a", values, noise=NOISE, start=[-1, 0], into=regions, shares=True
    )
    centre = (np.arange(cells) + 0.5) * 4 / cells - 2
    x, y = (each.ravel() for each in np.meshgrid(centre, centre, indexing="ij"))
    for a, share in zip(values, found.share, strict=True):
        first = along(x + 0.3 * (a * x - x**3) + 0.1 * y, NOISE[0], cells, axes[0])
        second = along(0.5 * y, NOISE[1], cells, axes[1])
        matrix = (first[:, :, None] * second[:, None]).reshape(x.size, x.size)
        limit = np.linalg.matrix_power(matrix, 1 << 14).mean(axis=0)
        # Three eighths of the grid of points in the cells from 1 to 4 / 3 are in the corner.
        part = np.where(y > 4 / 3, 1, np.where(y > 1, 3 / 8, 0)) * (x < 0)
        np.testing.assert_allclose(share, [limit[x > 0].sum(), limit @ part], atol=2e-7)


def test_shares_are_refused_where_the_system_leaves_the_box():
    with pytest.raises(ValueError, match="shares: a system that leaves the box at a sink"):
        dynamics.exit_times(
            system(("clamp", "sink"), 12),
            "a",
            [1.0],
            noise=NOISE,
            start=[-1, 0],
            into=left,
            shares=True,
        )
