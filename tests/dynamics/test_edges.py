"""Edge states of systems whose saddles are known in closed form."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from recordings import Recording

from jaxcell import dynamics
from jaxcell.cli.app import run
from jaxcell.space import Box


B, T, DAMPING = 0.5, 0.5, 0.3
SPIN = np.exp(2j * np.pi / 3)


def thomas(x, p):
    return jnp.stack([jnp.sin(x[(k + 1) % 3]) - B * x[k] for k in range(3)])


# Each map, its box, its saddle, and the rates of growth at the saddle.
CASES = {
    "double well": (
        dynamics.flow(lambda x, p: x - x**3, 0.25, 4),
        Box([-2], [2], [21]),
        [0.0],
        [1.0],
    ),
    "Duffing": (
        dynamics.flow(lambda x, p: jnp.stack([x[1], x[0] - x[0] ** 3 - 0.2 * x[1]]), 0.25, 4),
        Box([-2, -2], [2, 2], [41, 41]),
        [0.0, 0.0],
        [-0.1 + np.sqrt(1.01), -0.1 - np.sqrt(1.01)],
    ),
    "pendulum": (
        dynamics.flow(lambda x, p: jnp.stack([x[1], T - DAMPING * x[1] - jnp.sin(x[0])]), 0.25, 4),
        Box([-np.pi, -4], [np.pi, 6], [41, 41], ["periodic", "sink"]),
        [np.pi - np.arcsin(T), 0.0],
        [
            -DAMPING / 2 + np.sqrt(DAMPING**2 / 4 + np.sqrt(1 - T**2)),
            -DAMPING / 2 - np.sqrt(DAMPING**2 / 4 + np.sqrt(1 - T**2)),
        ],
    ),
    "Thomas": (
        dynamics.flow(thomas, 0.25, 4),
        Box([-3] * 3, [3] * 3, [12] * 3),
        [0.0] * 3,
        [1 - B, SPIN - B, SPIN.conjugate() - B],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_edge_state_between_two_attractors_is_the_saddle(name):
    map, box, saddle, rates = CASES[name]
    basins = dynamics.basins(map, box)
    assert basins.attractors == 2
    edges = dynamics.edge_states(map, basins)
    assert (edges.first.tolist(), edges.second.tolist()) == ([0], [1])
    assert (edges.period.tolist(), edges.unstable.tolist()) == ([1], [1])
    np.testing.assert_allclose(edges.point, [saddle], atol=1e-9)
    # The multipliers of four Runge-Kutta steps, each a quarter of a unit of time.
    rate = np.asarray(rates, complex) / 4
    step = 1 + rate + rate**2 / 2 + rate**3 / 6 + rate**4 / 24
    np.testing.assert_allclose(
        np.sort_complex(edges.multipliers[0]), np.sort_complex(step**4), atol=1e-8
    )


def test_edge_state_that_is_a_cycle_of_a_flow_is_followed():
    def rings(x, p):
        radius = jnp.sqrt(jnp.sum(x**2))
        growth = (radius - 1) * (2 - radius)
        return growth * x + jnp.stack([-x[1], x[0]])

    flow = dynamics.flow(rings, 0.125, 4)
    basins = dynamics.basins(flow, Box([-3, -3], [3, 3], [40, 40]))
    edges = dynamics.edge_states(flow, basins)
    assert (edges.period.tolist(), edges.unstable.tolist()) == ([0], [-1])
    (orbit,) = edges.orbit
    radius = np.linalg.norm(orbit[np.isfinite(orbit).all(axis=1)], axis=1)
    assert radius.size > 10
    np.testing.assert_allclose(radius, 1, atol=1e-4)


def test_cycle_of_points_on_a_boundary_has_its_period():
    # Each mapping swaps the two ends, and the two saddles; 0 is an attractor.
    def swap(x, p):
        return -(x + 0.5 * x * (x**2 - 1) * (4 - x**2) / 4)

    basins = dynamics.basins(swap, Box([-2.5], [2.5], [50]))
    edges = dynamics.edge_states(swap, basins)
    assert edges.period.tolist() == [2]
    np.testing.assert_allclose(np.abs(edges.point), 1, atol=1e-9)
    # The square of the slope at 1, -(1 + 0.5 * 2 * 3 / 4).
    np.testing.assert_allclose(edges.multipliers.real, [[1.75**2]], atol=1e-6)


def test_basins_without_a_boundary_have_no_edge_states():
    def down(x, p):
        return x / 2

    edges = dynamics.edge_states(down, dynamics.basins(down, Box([-1], [1], [9])))
    assert edges.point.shape == (0, 1)


OWN = """
import jax.numpy as jnp
from jaxcell import dynamics, space

def wells(x, p):
    return jnp.stack([x[0] + 0.4 * (x[0] - x[0] ** 3), 0.5 * x[1] + 0.25])

wells = dynamics.System(wells, space.Box([-2, 0], [2, 1], [40, 10]))
"""


def test_command_reports_and_draws_edge_states(tmp_path, capsys):
    path = tmp_path / "own.py"
    path.write_text(OWN)
    assert run(["dynamics", f"{path}:wells", "--edges", "--json", "--out", str(tmp_path)]) == 0
    (state,) = json.loads(capsys.readouterr().out)["edge_states"]
    assert (state["edge_first"], state["edge_second"], state["edge_unstable"]) == (0, 1, 1)
    assert state["edge_point"] == pytest.approx([0, 0.5], abs=1e-9)
    recorded = Recording(tmp_path / "dynamics.rrd")
    assert recorded.static("/box/edges/states", "Points2D:labels") == ["0 | 1"]
    (place,) = recorded.static("/box/edges/states", "Points2D:positions")
    assert list(place) == pytest.approx([5, 5], abs=1e-5)
    text = recorded.text()
    assert text.startswith("# Attractors and basins of the system wells")
