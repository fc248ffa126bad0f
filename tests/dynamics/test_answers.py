"""Sentences, tables and files that say what attractors are, and where."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxcell import dynamics, record
from jaxcell.cli.app import run
from jaxcell.space import Box


OWN = """
import jax.numpy as jnp
from jaxcell.dynamics import System, flow
from jaxcell.space import Box

def oscillator(x, p):
    return jnp.array([x[1], -2 * p["d"] * x[1] - x[0] - x[0] ** 3])

damped = System(
    flow(oscillator, 0.05, 20), Box([-2, -2], [2, 2], [31, 31]), {"d": 0.02}, ("place", "speed")
)
"""


@pytest.fixture
def damped(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(OWN)
    return f"{path}:damped"


def test_command_begins_with_kind_and_place_of_each_attractor(damped, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["dynamics", damped, "--out", str(out)]) == 0
    shown = capsys.readouterr()
    first, second, third, *_ = shown.out.splitlines()
    assert first.startswith("Attractor 0 is a point at (place, speed) = (0, 0)")
    share = re.fullmatch(r"(.*) % of the cells lead out of the box\.", second)
    assert third == "All orbits have settled."
    assert "--follow 4" in shown.err
    assert "follow=" not in shown.err
    (found,) = json.loads((out / "summary.json").read_text())["basins"]
    assert (found["kind"], found["return_time"]) == ("point", 0)
    assert found["point"] == found["lower"] == found["upper"] == [0, 0]
    with xr.open_dataset(out / "dynamics.nc") as saved:
        assert float(share[1]) == pytest.approx(100 * (1 - saved.fraction.item()), abs=0.06)
        assert saved.kind.values.tolist() == ["point"]
        for name in ("point", "lower", "upper"):
            np.testing.assert_array_equal(saved[name], [[0, 0]])


def test_command_along_parameters_says_where_it_ends_for_each(damped, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["dynamics", damped, "--params", "d=0.01:0.03:3", "--out", str(out)]
    assert run(command) == 0
    shown = capsys.readouterr()
    first, second, *_ = shown.out.splitlines()
    assert first == "Attractor 0 is a point at (place, speed) = (0, 0) for d=0.01 to d=0.03."
    assert second == "All orbits have settled."
    assert "a larger --follow" in shown.err
    found = json.loads((out / "summary.json").read_text())
    assert [each["parameters"] for each in found["branch"]] == ["d=0.01", "d=0.02", "d=0.03"]
    assert {each["kind"] for each in found["branch"]} == {"point"}
    assert [each["point"] for each in found["branch"]] == [[0, 0]] * 3
    assert [each["settled"] for each in found["members"]] == [True] * 3
    with xr.open_dataset(out / "dynamics.nc") as saved:
        assert saved.branch_kind.values.tolist() == ["point"] * 3
        np.testing.assert_array_equal(saved.branch_point, np.zeros((3, 2)))
        np.testing.assert_array_equal(saved.settled, [True] * 3)


def test_cycles_of_flows_have_the_period_and_place_of_their_formula():
    """Follow cycles with an angle `a' = w + b cos a`, whose turn takes `2 pi / sqrt(w^2 - b^2)`."""

    def field(x, p):
        radius = jnp.sqrt(x @ x)
        turn = p["w"] + p["b"] * x[0] / radius
        return x * (p["r"] - radius) + turn * jnp.stack([-x[1], x[0]])

    rng, count = np.random.default_rng(0), 6
    params = {"w": rng.uniform(0.7, 2, count), "r": rng.uniform(0.5, 1.5, count)}
    params["b"] = params["w"] * rng.uniform(-0.8, 0.8, count)
    box = Box([-2, -2], [2, 2], [40, 40])
    branches = dynamics.continuation(dynamics.flow(field, 0.05, 20), box, params)
    assert branches.settled.all()
    assert branches.branch_kind == ["cycle"] * count
    assert not branches.branch_period.any()
    period = 2 * np.pi / np.sqrt(params["w"] ** 2 - params["b"] ** 2)
    np.testing.assert_allclose(branches.branch_return_time, period, rtol=1e-4)
    size = np.stack([params["r"]] * 2, axis=1)
    np.testing.assert_allclose(branches.branch_upper, size, atol=5e-3)
    np.testing.assert_allclose(branches.branch_lower, -size, atol=5e-3)
    np.testing.assert_allclose(
        np.linalg.norm(branches.branch_point, axis=1), params["r"], rtol=1e-5
    )
    assert branches.answer[0].count(" of period ") == 2


def test_cycles_of_maps_have_their_points():
    rate = np.array([2.5, 3.2, 4.0])
    branches = dynamics.continuation(
        lambda x, p: p["r"] * x * (1 - x), Box([0], [1], [500]), {"r": rate}
    )
    assert branches.branch_kind == ["point", "cycle", "neither"]
    assert branches.branch_return_time is None
    root = np.sqrt((3.2 - 3) * (3.2 + 1))
    low, high = (4.2 - root) / 6.4, (4.2 + root) / 6.4
    np.testing.assert_allclose(branches.branch_lower[:, 0], [0.6, low, 0], atol=1e-4)
    np.testing.assert_allclose(branches.branch_upper[:, 0], [0.6, high, 1], atol=1e-4)
    (words,) = branches.answer[:-1]
    for part in ("a point at x0 = 0.6 for r=2.5", "a cycle of 2 points through x0 = ", "chaos"):
        assert part in words


def test_forced_oscillation_is_a_cycle_of_the_period_of_the_force():
    # The solution is (cos t + sin t) / 2.
    forced = dynamics.strobe(lambda t, x, p: jnp.cos(t)[None] - x, 2 * np.pi, 100)
    basins = dynamics.basins(forced, Box([-1], [1], [20]))
    assert (basins.kind, basins.period.tolist()) == (["cycle"], [1])
    np.testing.assert_allclose(basins.return_time, 2 * np.pi)
    np.testing.assert_allclose(basins.point, 0.5, rtol=1e-5)
    assert record.summary(basins)["basins"][0]["point"] == basins.point[0].tolist()


def test_torus_has_no_period():
    def field(x, p):
        each = (x[:2], 1.0), (x[2:], (5**0.5 + 1) / 2)
        return jnp.concatenate([y * (1 - y @ y) + w * jnp.stack([-y[1], y[0]]) for y, w in each])

    torus = dynamics.basins(dynamics.flow(field, 0.05, 20), Box([-1.5] * 4, [1.5] * 4, [9] * 4))
    assert torus.kind == ["neither"]
    assert np.isinf(torus.return_time).all()
    np.testing.assert_allclose(torus.upper, 1, atol=5e-3)


def test_unsettled_orbits_are_reported_in_the_answer():
    basins = dynamics.basins(lambda x, p: x - x**3, Box([-1], [1], [31]))
    assert "have not settled" in basins.answer[-1]
    branches = dynamics.continuation(
        lambda x, p: p["a"] * x - x**3, Box([-1], [1], [31]), {"a": [0.5, 1.0]}
    )
    assert branches.settled.tolist() == [True, False]
    assert branches.answer[-1].startswith("For a=1, orbits have not settled")


def test_box_that_all_orbits_leave_has_no_attractor():
    basins = dynamics.basins(lambda x, p: x + 0.1, Box([0], [1], [10]))
    assert basins.answer[0].startswith("No attractor was found")
    assert basins.lower.shape == (0, 1)


def test_shares_of_orbits_come_before_those_of_cells():
    box = Box([-1.0], [1.0], [20], "clamp")
    (found, *_) = dynamics.basins(lambda x, p: x / 2, box).answer
    assert found.endswith(
        "100.0% of the orbits from random starts end on it, and 100.0% of the cells lead to it."
    )
