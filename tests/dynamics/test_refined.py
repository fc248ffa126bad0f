import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxcell import dynamics
from jaxcell.space import Box


def sloping(x, p):
    """Map both sides of a line, which is parallel to no axis, to one point each."""
    return jnp.where(x[0] + 0.37 * x[1] > 0.113, jnp.array([0.8, 0.5]), jnp.array([-0.8, 0.5]))


def test_line_is_refined_to_its_exact_share():
    basins = dynamics.basins(sloping, Box([-1, -1], [1, 1], [20, 20]))
    fine = dynamics.refined(sloping, basins, 5)
    right = (1 - 0.113) / 2
    np.testing.assert_allclose(np.sort(fine.fraction), [right, 1 - right], atol=1e-3)
    assert fine.exponent == pytest.approx(1, abs=0.02)
    # Only cells at the line are followed, of 400 * 4^5 cells.
    assert fine.mapped < 20_000
    apart = fine.boundary @ np.array([1, 0.37]) - 0.113
    assert np.abs(apart).max() < 1.4 * 0.1 / 2**5
    assert (fine.basin == basins.basin[basins.box.index(np.array([0.8, 0.5]))])[apart > 0].all()


def henon(x, p):
    return jnp.stack([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])


def test_refined_basins_equal_those_of_finer_cells():
    coarse = dynamics.basins(henon, Box([-2, -2], [2, 2], [101, 101]))
    fine = dynamics.refined(henon, coarse, 2)
    # The share is 0.43249 with 2000^2 cells, and 0.4287 with 101^2.
    assert fine.fraction[0] == pytest.approx(0.4325, abs=0.001)
    assert fine.mapped < 0.2 * coarse.box.size * 16
    x = np.unique(fine.boundary[:, 0])
    assert np.diff(x).min() == pytest.approx(4 / 404)


def test_boundaries_wrap_around_periodic_axes():
    def halves(x, p):
        return jnp.where((x > 0.25) & (x < 0.7), 0.5, 0.0)

    basins = dynamics.basins(halves, Box([0], [1], [10], "periodic"))
    fine = dynamics.refined(halves, basins, 4)
    np.testing.assert_allclose(np.sort(fine.fraction), [0.45, 0.55], atol=1 / 160)
    assert fine.boundary.size == 4


def test_one_basin_has_no_boundary():
    def back(x, p):
        return x / 2

    fine = dynamics.refined(back, dynamics.basins(back, Box([-1], [1], [9])))
    assert (fine.fraction.tolist(), fine.mapped, fine.boundary.size) == ([1], 0, 0)
    assert np.isnan(fine.exponent)


def test_cover_is_the_attractor_and_its_unstable_sets():
    # x' = x - x^3, y' = -3 y: the segment from (-1, 0) to (1, 0), through the saddle at 0.
    flow = dynamics.flow(lambda x, p: jnp.stack([x[0] - x[0] ** 3, -3 * x[1]]), 0.1, 5)
    cover = dynamics.relative_attractor(flow, Box([-2, -2], [2, 2], [5, 5]), levels=5)
    width = 4 / (5 * 2**5)
    assert np.abs(cover[:, 1]).max() < 2 * width
    assert np.abs(cover[:, 0]).max() < 1 + 2 * width
    assert np.diff(np.unique(cover[:, 0])).max() == pytest.approx(width)
    assert cover[:, 0].max() > 1 - width


def test_exponent_of_cantor_boundary_is_its_codimension():
    def thirds(x, p):
        # The points that stay are Cantor's set; both halves of each gap go to another end.
        middle = jnp.where(x < 0.5, -0.5, 1.5)
        inside = jnp.where(x < 1 / 3, 3 * x, jnp.where(x > 2 / 3, 3 * x - 2, middle))
        return jnp.where(x < 0, -0.5, jnp.where(x > 1, 1.5, inside))

    # The centres of cells of width 3^-3 miss most of the boundary.
    basins = dynamics.basins(thirds, Box([-1], [2], [81]), by="orbits")
    fine = dynamics.refined(thirds, basins, 9)
    assert fine.exponent == pytest.approx(1 - np.log(2) / np.log(3), abs=0.03)
    np.testing.assert_allclose(fine.fraction, 0.5, atol=0.005)


def newton(x, p):
    """Newton's method for z^3 = 1: near 0, a step leads far out of the box."""
    z = lax.complex(x[0], x[1])
    z = z - (z**3 - 1) / (3 * z**2)
    return jnp.stack([z.real, z.imag])


def test_refined_points_are_followed_outside_the_box_as_the_basins_were():
    basins = dynamics.basins(newton, Box([-2, -2], [2, 2], [101, 101]), by="orbits", follow=64)
    fine = dynamics.refined(newton, basins, 2)
    np.testing.assert_allclose(fine.fraction, basins.fraction, atol=0.01)
    assert fine.fraction.sum() > 0.999
