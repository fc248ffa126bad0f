import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import dynamics
from jaxcell.dynamics.imaging import changed_by_half_step, images_of_each
from jaxcell.space import Box


def turning(x, p):
    return jnp.stack([x[1], -x[0]])


def mapped(map, *point):
    """Map a point once."""
    return jax.jit(map)(np.array(point), None)


def test_strobe_follows_the_phase_of_the_force():
    # x' = cos(t) returns after a period; x' = cos(t)^2 moves by pi.
    back = dynamics.strobe(lambda t, x, p: jnp.cos(t)[None], 2 * np.pi, 100)
    on = dynamics.strobe(lambda t, x, p: jnp.cos(t)[None] ** 2, 2 * np.pi, 100)
    np.testing.assert_allclose(mapped(back, 0.3), [0.3], atol=1e-9)
    np.testing.assert_allclose(mapped(on, 0.3), [0.3 + np.pi], atol=1e-9)


def test_section_of_a_spiral_is_its_return_map():
    # r' = -r / 10, a turn in 2 pi: a return multiplies the radius by exp(-pi / 5).
    def spiral(x, p):
        return jnp.stack([-0.1 * x[0] - x[1], x[0] - 0.1 * x[1]])

    returns = dynamics.section(
        spiral,
        lambda x, p: x[1],
        # Rounding puts the start before the surface, which it does not cross at once.
        lift=lambda u, p: jnp.stack([u[0], -1e-17 * u[0]]),
        project=lambda x, p: x[:1],
        dt=0.05,
        max_steps=1000,
    )
    expected = 2 * np.exp(-np.pi / 5)
    np.testing.assert_allclose(mapped(returns, 2.0), [expected], rtol=1e-6)
    time = np.empty((1, 20), np.float32)
    images_of_each(returns, Box([0.01], [1.01], [20]), [None], time=time)
    np.testing.assert_allclose(time, 2 * np.pi, rtol=1e-4)


def damped_turn(u, a, w):
    """Follow `r' = -a r` for a turn at the angular velocity `w`; return the radius and the time."""
    returns = dynamics.section(
        lambda x, p: jnp.stack([-a * x[0] - p * x[1], p * x[0] - a * x[1]]),
        lambda x, p: x[1],
        lift=lambda u, p: jnp.stack([u[0], 0.0 * u[0]]),
        project=lambda x, p: x[:1],
        dt=0.02,
    )
    place, time = returns.timed(u[None], w)
    return jnp.append(place, time)


def test_section_has_the_derivatives_of_the_closed_form():
    def exact(u, a, w):
        return jnp.stack([u * jnp.exp(-a * 2 * jnp.pi / w), 2 * jnp.pi / w])

    # The field contains `a`, and `w` is its parameter.
    ways = tuple(range(3))
    points = jnp.array([1.3, 0.7]), jnp.array([0.1, 0.2]), jnp.array([1.1, 0.9])
    slopes = jax.jit(jax.vmap(jax.jacrev(damped_turn, ways)))(*points)
    np.testing.assert_allclose(slopes, jax.vmap(jax.jacrev(exact, ways))(*points), atol=2e-7)
    turn = jax.jit(jax.vmap(damped_turn))
    for k, slope in enumerate(slopes):
        low, high = (turn(*(x + h * (k == n) for n, x in enumerate(points))) for h in (-1e-5, 1e-5))
        np.testing.assert_allclose(slope, (high - low) / 2e-5, atol=1e-8)
    curved = jax.jit(jax.grad(jax.grad(lambda a: damped_turn(points[0][0], a, 1.1)[0])))(0.1)
    assert curved == pytest.approx((2 * np.pi / 1.1) ** 2 * exact(1.3, 0.1, 1.1)[0].item())


def test_section_returns_to_a_curved_surface():
    # The search for the crossing ends on the surface, however long the steps are.
    def surface(x, p):
        return x[1] - x[0] ** 3 / 8

    returns = dynamics.section(
        turning, lambda x, p: -surface(x, p), lift=lambda u, p: u, project=lambda x, p: x, dt=0.3
    )
    starts = np.linspace(0.1, 2, 50)
    ends = jax.vmap(returns, (0, None))(np.stack([starts, starts**3 / 8], axis=1), None)
    assert np.abs(jax.vmap(surface, (0, None))(ends, None)).max() < 1e-14


def test_section_without_return_maps_nowhere():
    away = dynamics.section(
        lambda x, p: jnp.ones(2),
        lambda x, p: x[1],
        lift=lambda u, p: jnp.stack([u[0], 0.0 * u[0]]),
        project=lambda x, p: x[:1],
        dt=0.1,
        max_steps=20,
    )
    box = Box([0], [1], [4])
    assert dynamics.images(away, box).tolist() == [box.nowhere] * 4


def test_images_in_chunks_equal_images_at_once(monkeypatch):
    box = Box([-2, -2], [2, 2], [40, 30])
    flow = dynamics.flow(turning, 0.1, 7)
    whole = dynamics.images(flow, box)
    monkeypatch.setattr("jaxcell.dynamics.imaging.CHUNK", 500)
    assert (dynamics.images(flow, box) == whole).all()
    # Some cells are mapped one by one.
    for cell in (0, 77, 1199):
        end = mapped(flow, *box.centre(np.array([cell]))[0])
        assert whole[cell] == int(box.index(np.asarray(end)))


def test_crossing_moves_each_cell_by_the_given_distance():
    box = Box([-8, -8], [8, 8], [64, 64])
    flow = dynamics.flow(turning, 0.01, crossed=3, max_steps=2000)
    image = dynamics.images(flow, box)
    inside = image < box.size
    here, there = (box.coordinates(x) for x in (np.flatnonzero(inside), image[inside]))
    apart = np.abs(there - here).max(axis=1)
    # Cells beside the centre turn on smaller circles.
    radius = np.hypot(*box.centre(np.flatnonzero(inside)).T)
    assert (apart[radius > 1] == 3).all()


def test_points_outside_are_followed_back():
    def swing(x, p):
        return -1.5 * x

    box = Box([-1], [1], [4])
    assert dynamics.images(swing, box).tolist() == [4, 2, 1, 4]

    def back(x, p):
        return jnp.where(jnp.abs(x) > 1, x / 10, -1.5 * x)

    assert dynamics.images(back, box, follow=1).tolist() == [2, 2, 1, 1]


def henon(x, p):
    return jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], p["b"] * x[0]])


def pendulum(x, p):
    return jnp.stack([x[1], -jnp.sin(x[0]) - p["a"] * x[1] + p["b"]])


@pytest.mark.parametrize(
    ("map", "follow"),
    [
        (henon, 0),
        (henon, 3),
        (dynamics.flow(pendulum, 0.05, 7), 0),
        (dynamics.flow(pendulum, 0.05, max_steps=30), 0),
        (dynamics.flow(pendulum, 0.05, max_steps=30), 2),
    ],
)
def test_images_of_traced_parameters_are_those_of_each(map, follow, monkeypatch):
    box = Box([-2, -1], [2, 1], cells=[20, 15])
    params = {"a": np.array([1.4, 0.2, 0.9]), "b": np.array([0.3, 0.8, -0.2])}

    def images(params):
        return dynamics.images(map, box, params, follow=follow)

    each = [images({name: float(v[k]) for name, v in params.items()}) for k in range(3)]
    np.testing.assert_array_equal(jax.jit(jax.vmap(images))(params), each)
    # In chunks, the last of which is shorter.
    monkeypatch.setattr("jaxcell.dynamics.imaging.CHUNK", 128)
    np.testing.assert_array_equal(jax.vmap(images)(params), each)


def test_half_steps_reveal_coarse_steps():
    box = Box([-2, -2], [2, 2], [64, 64])

    def changed(map):
        return changed_by_half_step(map, box, [None], dynamics.images(map, box)[None])[0]

    assert changed(dynamics.flow(turning, 0.01, 100)) < 0.01
    assert changed(dynamics.flow(turning, 1.0, 6)) > 0.5
    assert changed(lambda x, p: x) is None


@pytest.mark.parametrize(
    ("map", "message"),
    [
        (lambda x, p: x[:1], "^map: expected an array of shape \\[2\\], got \\[1\\]$"),
        (lambda x, p: (x[0], x[1]), "^map: expected an array, got a tuple$"),
        (lambda x, p: jnp.sign(x).astype(int), "^map: expected numbers of float.*, got int64$"),
        (lambda x, p: x * (1 / 0), "fails at the middle of the box: division by zero"),
        (lambda x, p: x * speed, "fails at the middle of the box: name 'speed' is not defined"),
        (lambda x, p: x * p["speed"], r"no parameter 'speed'; pass params=\{'speed': ...\}$"),
        (lambda x: np.sin(x), "write jax.numpy.sin for numpy.sin and math.sin"),
        (lambda x: np.array([math.sin(x[0]), 0.0]), "write jax.numpy.sin for numpy.sin and math"),
        (dynamics.flow(lambda x, p: np.sin(x), 0.1), "write jax.numpy.sin for numpy.sin and math"),
        (lambda x: x if x[0] > 0 else -x, "JAX traces it: .*, jnp.where for `if`$"),
        (dynamics.flow(lambda x, p: x[:1], 0.1, 2), "^field: expected an array of shape .2., got"),
        (lambda x, p: x * jnp.nan, "^map: expected finite numbers, got none at 64 points$"),
        (dynamics.flow(lambda x, p: x / 0.0, 0.1), "^field: expected finite numbers, got none at"),
        (dynamics.strobe(lambda t, x, p: x / t, 1.0, 2), "^field: expected finite numbers, got"),
    ],
)
def test_bad_maps_are_refused(map, message):
    with pytest.raises(ValueError, match=message):
        dynamics.images(map, Box([0, 0], [1, 1], [2, 2]), {})
    if "parameter" in message:
        with pytest.raises(ValueError, match=message):
            dynamics.images(map, Box([0, 0], [1, 1], [2, 2]))
