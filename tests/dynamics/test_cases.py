"""Systems whose groups, basins or sets were published, or counted with other programs."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.dynamics import systems
from jaxcell.space import Box


MU = 0.1 * np.pi
C, D = (1 - np.exp(-2 * MU)) / (2 * MU), np.exp(-2 * MU)


def double_well(x, p):
    return jnp.stack([x[1], -1.2 * x[1] + x[0] - x[0] ** 3])


def kicked_bar(x, p):
    speed = x[1] - 5.7 * jnp.sin(x[0])
    return jnp.stack([x[0] + C * speed, D * speed])


def edges(x, p):
    return jnp.stack([0.9 * x[1] + 1.81 * x[0] ** 2, -0.9 * x[0]])


def pendulum(x, p):
    return jnp.stack([x[1], p["T"] - 0.1 * x[1] - jnp.sin(x[0])])


def cylinder(cells):
    """The box of the pendulum, of its angle and speed."""
    return Box([-np.pi, -10], [np.pi, 10], [cells, cells], ["periodic", "sink"])


def square(half):
    return Box([-half] * 2, [half] * 2, [151] * 2)


# Results of Sun and Xiong's programs for the cell mapping method in MATLAB. Henon's map and the map
# with images on edges were computed with NumPy, because there an edge belongs to the upper cell.
MAPS = {
    "Duffing": (systems.duffing.map, systems.duffing.box, systems.duffing.params),
    "double well": (dynamics.flow(double_well, 0.05, 20), square(1.5), None),
    "Hsu's bar": (kicked_bar, Box([-np.pi, -7], [np.pi, 7], [115, 151]), None),
    "edges": (edges, square(1.5), None),
    "Henon": (systems.henon.map, square(2), systems.henon.params),
}
# The number of groups by period, the lost cells, the most mappings, and the sizes of basins.
PUBLISHED = {
    "Duffing": ({2: 2, 3: 2, 28: 1}, 0, 31, [18317, 3048, 854, 353, 229]),
    "double well": ({1: 3}, 0, 15, [11377, 11377, 47]),
    "Hsu's bar": ({1: 1, 6: 2}, 11070, 24, [5042, 1252, 1]),
    "edges": ({1: 1, 4: 11}, 17207, 37, [2120, 1961]),
    "Henon": ({2: 1, 14: 1}, 12974, 52, [9789, 38]),
}


@pytest.mark.parametrize("name", MAPS)
def test_groups_equal_published_groups(name):
    periods, lost, longest, largest = PUBLISHED[name]
    basins = dynamics.basins(*MAPS[name])
    assert Counter(basins.group_period.tolist()) == periods
    basin = np.bincount(basins.group, minlength=basins.groups + 2)
    assert basin[basins.groups] == lost
    assert basin[basins.groups + 1] == 0
    # Cells that leave may need more mappings than those that stay.
    assert max(basins.longest_step, int(basins.step.max())) == longest
    assert sorted(basin[: basins.groups])[::-1][: len(largest)] == largest


def test_basin_share_of_pendulum_equals_monte_carlo():
    basins = dynamics.basins(dynamics.flow(pendulum, 0.05, 120), cylinder(151), {"T": 0.5})
    # 0.152 of 10,000 starts of bSTAB, 0.1523 of a grid of 150^2.
    assert basins.fraction.min() == pytest.approx(0.152, abs=0.004)
    assert basins.groups > basins.attractors == 2
    assert sorted(basins.period)[1] == 1
    assert basins.changed < 0.01
    assert basins.remarks == ()


def test_crossing_times_leave_few_cells_mapped_to_themselves():
    slow = dynamics.basins(dynamics.flow(pendulum, 0.01, 1), cylinder(11), {"T": 0.5})
    assert slow.self_images > 0.1
    assert any("own images" in remark for remark in slow.remarks)
    crossing = dynamics.basins(dynamics.flow(pendulum, 0.05), cylinder(31), {"T": 0.5})
    # Only the cell of the equilibrium is its own image.
    assert round(crossing.self_images * crossing.box.size) <= 1
    assert crossing.attractors == 2
    assert crossing.fraction.min() == pytest.approx(0.152, abs=0.04)


def test_cycle_of_a_whole_number_of_steps_is_one_attractor():
    # A turn takes four steps, each over a thousand cells.
    ring = dynamics.flow(lambda x, p: jnp.stack([2.5 + 0 * x[0], 0.5 - x[1]]), 0.1, 5)
    basins = dynamics.basins(ring, Box([0, 0], [1, 1], [4000, 3], ["periodic", "sink"]))
    assert basins.attractors == 1


@pytest.mark.parametrize("axes", [1, 2])
def test_orbits_and_cells_agree_where_cells_are_fine(axes):
    box = Box([-2] * axes, [2] * axes, [40] * axes)

    def wells(x, p):
        return x + 0.3 * (x - x**3)

    by_cells = dynamics.basins(wells, box)
    by_orbits = dynamics.basins(wells, box, by="orbits")
    assert by_cells.attractors == by_orbits.attractors == 2**axes
    assert (by_cells.basin == by_orbits.basin).all()
    assert not any("random starts" in remark for remark in by_cells.remarks)


def test_orbits_find_attractors_that_coarse_cells_miss():
    box, flow = cylinder(31), dynamics.flow(pendulum, 0.05, 20)
    coarse = dynamics.basins(flow, box, {"T": 0.5})
    assert abs(coarse.fraction.min() - 0.152) > 0.03
    assert any("take basins by orbits" in remark for remark in coarse.remarks)
    basins = dynamics.basins(flow, box, {"T": 0.5}, by="orbits")
    # 961 starts have a standard error of 0.012.
    assert basins.fraction.min() == pytest.approx(0.152, abs=0.035)


def test_orbits_that_leave_are_followed_for_the_given_mappings():
    def back(x, p):
        return jnp.where(jnp.abs(x) > 1, x / 10, jnp.where(jnp.abs(x) > 0.5, 3 * x, 0.9 * x))

    box = Box([-1], [1], [40])
    assert dynamics.basins(back, box, by="orbits").outside_share == 0.5
    assert dynamics.basins(back, box, by="orbits", follow=1).outside_share == 0
    advice = "take basins by orbits, which agree if points are followed outside the box (follow=1)"
    assert any(advice in remark for remark in dynamics.basins(back, box).remarks)
    assert not any("outside" in remark for remark in dynamics.basins(back, box, follow=1).remarks)


def test_periodic_axis_whose_ends_differ_is_reported(monkeypatch):
    box = Box([0, 0], [1, 1], [10, 10], ["periodic", "sink"])
    with pytest.warns(UserWarning, match="The axis x0 is periodic"):
        torn = dynamics.continuation(lambda x, p: x * p["rate"], box, {"rate": [0.5, 1.0]})
    warning = "The axis x0 is periodic, but the map differs at its two ends."
    assert torn.members[0].remarks[0] == warning
    # The identity is the same at both ends.
    assert not any("periodic" in remark for remark in torn.members[1].remarks)
    assert torn.remarks[0].startswith(f"2 of 2 parameters have remarks, as rate=0.5: {warning}")
    with pytest.warns(UserWarning, match="The axis x0 is periodic"):
        dynamics.chain(lambda x, p: 0.5 * x, box, samples=1)
    twice = dynamics.basins(lambda x, p: jnp.stack([2 * x[0], 0.5 * x[1]]), box)
    assert not any("periodic" in remark for remark in twice.remarks)
    # The warning comes before cells are mapped.
    monkeypatch.setattr("jaxcell.dynamics.basin.images_of_each", None)
    with pytest.warns(UserWarning, match="The axis x0"), pytest.raises(TypeError):
        dynamics.basins(lambda x, p: 0.5 * x, box)


def test_cover_of_lorenz_attractor_equals_gaio():
    def lorenz(x, p):
        return jnp.stack(
            [10 * (x[1] - x[0]), 28 * x[0] - x[1] - x[0] * x[2], x[0] * x[1] - 0.4 * x[2]]
        )

    centre, radius = np.array([0.1, 0.1, 27]), np.array([30, 30, 40])
    box = Box(centre - radius, centre + radius, [128] * 3)
    side = np.sqrt(0.4 * 27)
    start = [[side, side, 27], [-side, -side, 27]]
    assert dynamics.unstable_set(dynamics.flow(lorenz, 0.01, 10), box, start).size == 33_320


def test_near_attractors_are_not_merged():
    # A chaotic one and a cycle, less than half a cell apart. Attractors.jl: 0.645 of 1,000 starts,
    # 0.18 and 0.175; by orbits of 61^3 cells 0.635, 0.185 and 0.175.
    box = Box([-3] * 3, [3] * 3, [63] * 3)
    basins = dynamics.basins(systems.lorenz84.map, box, systems.lorenz84.params)
    assert basins.period.tolist() == [1, 0, 0]
    np.testing.assert_allclose(basins.sampled, [0.645, 0.18, 0.175], atol=0.08)
    assert sum("from random starts end on it" in remark for remark in basins.remarks) == 3
    assert "take basins by orbits, which agree" in basins.remarks[0]


def test_magnetic_pendulum_has_three_attractors():
    # Orbits start at rest, leave the thin box around these states, and come back.
    system = systems.magnetic
    box = Box([-2, -2, -0.04, -0.04], [2, 2, 0.04, 0.04], [25, 25, 1, 1])
    basins = dynamics.basins(system.map, box, system.params, follow=200)
    assert basins.attractors == 3
    # Attractors.jl: 0.314, 0.309 and 0.377 of some hundred starts, by orbits 0.332, 0.331, 0.337.
    np.testing.assert_allclose(basins.fraction, [0.337, 0.332, 0.331], atol=0.01)


def test_fractions_of_the_pendulum_along_its_torque():
    torque = np.array([0.11, 0.26, 0.46, 0.66, 0.96])
    # bSTAB, 10,000 starts each, of a standard error up to 0.005.
    rest = [1, 0.3268, 0.1703, 0.0839, 0.0071]
    flow = dynamics.flow(pendulum, 0.05, 120)
    continued = dynamics.continuation(flow, cylinder(51), {"T": torque})
    assert continued.attractors == 2
    assert continued.fraction[0, 0] == 1
    np.testing.assert_allclose(continued.fraction[:, 0], rest, atol=0.015)
    assert continued.appears.tolist() == [0, 1]
    assert continued.vanishes.tolist() == [4, 4]


def test_section_of_van_der_pol_has_its_period():
    def field(x, p):
        return jnp.stack([x[1], p["mu"] * (1 - x[0] ** 2) * x[1] - x[0]])

    def section(dt):
        return dynamics.section(
            field,
            lambda x, p: x[0],
            lift=lambda u, p: jnp.stack([jnp.zeros_like(u[0]), u[0]]),
            project=lambda x, p: x[1:],
            dt=dt,
        )

    params = {"mu": 1.0}
    basins = dynamics.basins(section(0.2), Box([0.1], [8], [40]), params)
    assert basins.period.tolist() == [1]
    assert basins.fraction.tolist() == [1]
    # The period by a solver of high order; it takes smaller steps than the cycle.
    fine = section(0.01)
    time = jax.jit(lambda x: fine.timed(fine(x, params), params)[1])(basins.orbit[0, -1])
    assert float(time) == pytest.approx(6.66328686, abs=1e-5)


@pytest.mark.parametrize("axes", [4, 5, 6])
def test_groups_of_product_maps_are_products_of_groups(axes):
    kinds = ["sink", "periodic", "clamp"] * 2
    box = Box([-2] * axes, [2] * axes, [4, 5, 3, 4, 2, 3][:axes], kinds[:axes])
    rates = np.array([1.4, 2.0, 3.0, -0.7, 1.0, -1.5])[:axes]
    shift = np.array([0.1, 0.3, -0.2, 0.4, 2.0, 0.0])[:axes]
    image = dynamics.images(lambda x, p: rates * x + shift, box)
    # The image of each axis by itself, -1 if it leaves the axis.
    along = []
    for axis, (count, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
        centre = -2 + (np.arange(count) + 0.5) * 4 / count
        place = np.floor((rates[axis] * centre + shift[axis] + 2) / 4 * count + 1e-9).astype(int)
        if kind == "periodic":
            place %= count
        elif kind == "clamp":
            place = np.clip(place, 0, count - 1)
        along.append(np.where((place >= 0) & (place < count), place, -1))
    each = np.stack(np.meshgrid(*along, indexing="ij")).reshape(axes, -1)
    inside = (each >= 0).all(axis=0)
    assert 0 < np.count_nonzero(~inside) < box.size
    expected = np.where(inside, np.ravel_multi_index(np.maximum(each, 0), box.cells), box.outside)
    np.testing.assert_array_equal(image, expected)
