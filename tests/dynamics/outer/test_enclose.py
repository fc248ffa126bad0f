"""Interval images are compared with Arb, by exact values to 60 digits at points of boxes."""

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxcell import dynamics


BOXES = 300


class Exact:
    """Functions of jax.numpy for numbers of Arb."""

    def __getattr__(self, name):
        return lambda x: getattr(x, name)()

    absolute = staticmethod(abs)
    maximum = staticmethod(lambda a, b: a if a > b else b)
    minimum = staticmethod(lambda a, b: a if a < b else b)
    where = staticmethod(lambda which, a, b: a if which else b)
    mod = staticmethod(lambda a, b: a - (a / b).floor() * b)
    floor = staticmethod(lambda a: a.floor())


# Each map takes the functions and two numbers, and returns two numbers.
MAPS = {
    "leslie": lambda m, x, y: ((19.6 * x + 23.68 * y) * m.exp(-0.1 * (x + y)), 0.7 * x),
    "henon": lambda m, x, y: (1 - 1.4 * x**2 + y, 0.3 * x),
    "waves": lambda m, x, y: (m.sin(3 * x) * m.cos(y), m.cos(x - y) - m.sin(x * y)),
    "quotients": lambda m, x, y: (x / (y * y + 0.1), (x - y) / (x + 40.0)),
    "powers": lambda m, x, y: (x**3 - y**4, (x * x + 0.5) ** 1.7 - x**5),
    "roots": lambda m, x, y: (m.sqrt(x * x + y * y), m.log(x * x + 1e-3)),
    "steep": lambda m, x, y: (m.tanh(2 * x - y), m.exp(10 * x) * m.exp(-20 * y)),
    "hyperbolic": lambda m, x, y: (m.sinh(x) - m.cosh(y), m.tan(0.3 * x) + m.cosh(x - y)),
    "kinks": lambda m, x, y: (m.absolute(x - y), m.maximum(x, y * y) - m.minimum(x, 0.5 * y)),
    "branches": lambda m, x, y: (m.where(x > y, x * y, x - 2 * y), m.where(x <= 1.0, x, -y)),
    "steps": lambda m, x, y: (m.mod(x, 0.7), m.floor(3 * y) * x),
    "small": lambda m, x, y: ((x - 1.0) * 1e-170 * (y * 1e-170), x * 1e-200 / (1e-190 + y * y)),
}


def looped(x, p):
    """The map `turned`, by loops, branches and matrices of JAX."""
    turn = jnp.array([[0.6, -0.8], [0.8, 0.6]])
    x = lax.fori_loop(0, 5, lambda k, y: turn @ y + 0.1 * jnp.asarray(k, x.dtype), x)
    x = lax.cond(x[0] > 0.5, lambda y: y, lambda y: -y[::-1], x)
    return jax.vmap(lambda y: jnp.sum(jnp.stack([y, y * y])))(x.at[1].set(jnp.max(x)))


def turned(m, x, y):
    for k in range(5):
        x, y = 0.6 * x - 0.8 * y + 0.1 * k, 0.8 * x + 0.6 * y + 0.1 * k
    x, y = (x, y) if x > 0.5 else (-y, -x)
    y = m.maximum(x, y)
    return x + x * x, y + y * y


PENDULUM = dynamics.flow(lambda x, p: jnp.stack([x[1], 0.5 - jnp.sin(x[0])]), dt=0.25, steps=3)


def pendulum(m, x, y):
    """Three steps of Runge and Kutta."""
    for _ in range(3):
        slopes = [(y, 0.5 - m.sin(x))]
        for part in (0.125, 0.125, 0.25):
            a, b = slopes[-1]
            slopes.append((y + part * b, 0.5 - m.sin(x + part * a)))
        weights = (1, 2, 2, 1)
        # The parts of a step are the numbers of 64 bits.
        x = x + 0.25 / 6 * sum(w * a for w, (a, _) in zip(weights, slopes, strict=True))
        y = y + 0.25 / 6 * sum(w * b for w, (_, b) in zip(weights, slopes, strict=True))
    return x, y


MAPS |= {"loops": turned, "flow": pendulum}
OF_JAX = {"loops": looped, "flow": PENDULUM}


def of_jax(name):
    return OF_JAX.get(name, lambda x, p: jnp.stack(MAPS[name](jnp, x[0], x[1])))


def boxes(rng, count):
    """Boxes of widths from 1e-15 to 3, some of which end on whole numbers or at 0."""
    lower = rng.uniform(-8, 8, (count, 2)) * 10 ** rng.uniform(-3, 0, (count, 1))
    lower[: count // 8] = np.round(lower[: count // 8])
    upper = lower + 10 ** rng.uniform(-15, 0.5, (count, 2))
    upper[: count // 16] = np.ceil(upper[: count // 16])
    return lower, upper


def violations(name, lower, upper, images, rng):
    """Count the boxes from which some point has an image outside."""
    shares = np.concatenate([[[0, 0], [1, 1], [0, 1], [1, 0]], rng.uniform(0, 1, (2, 2))])
    low_image, high_image = images
    wrong = 0
    for k in range(len(lower)):
        points = lower[k] + shares * (upper[k] - lower[k])
        for point in np.clip(points, lower[k], upper[k]):
            exact = MAPS[name](Exact(), *map(flint.arb, point.tolist()))
            inside = (
                flint.arb(low) <= value <= flint.arb(high)
                for value, low, high in zip(exact, low_image[k], high_image[k], strict=True)
            )
            if not all(inside):
                wrong += 1
                break
    return wrong


@pytest.fixture(autouse=True)
def sixty_digits():
    with flint.ctx.workprec(200):
        yield


@pytest.mark.parametrize("name", MAPS)
def test_images_of_boxes_contain_exact_images_of_their_points(name):
    rng = np.random.default_rng(0)
    lower, upper = boxes(rng, BOXES)
    images = dynamics.Intervals(of_jax(name), mean_value=name != "flow").images(lower, upper)
    assert violations(name, lower, upper, images, rng) == 0


@pytest.mark.parametrize("name", ["exp", "log", "sin", "cos", "tanh", "sqrt"])
def test_functions_of_points_are_as_accurate_as_stated(name):
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-far, far, 500) for far in (1e-6, 1, 30, 700)])
    if name == "tanh":
        points = points[:1500]
    if name in ("log", "sqrt"):
        points = 10 ** (points / 3)
    lower, upper = dynamics.Intervals(lambda x, p: getattr(jnp, name)(x), False).images(
        points[:, None], points[:, None]
    )
    exact = [getattr(Exact(), name)(flint.arb(x)) for x in points.tolist()]
    assert all(
        flint.arb(a) <= x <= flint.arb(b)
        for a, x, b in zip(lower[:, 0].tolist(), exact, upper[:, 0].tolist(), strict=True)
    )
    width = upper[:, 0] - lower[:, 0]
    stated = {"sin": 2.0**-48, "cos": 2.0**-48, "tanh": 2.0**-47}
    # Results nearer to 0 than 2^-1000 may have lost all digits.
    assert (width <= stated.get(name, 2.0**-47 * np.abs(upper[:, 0]) + 2.0**-998)).all()


def test_image_of_a_crest_is_exactly_one():
    lower, upper = dynamics.Intervals(lambda x, p: jnp.sin(x)).images(
        np.array([[1.0], [-2.0], [0.0], [1e7]]), np.array([[2.0], [-1.0], [7.0], [1e7 + 1e-3]])
    )
    assert upper[[0, 2, 3], 0].tolist() == [1, 1, 1]
    assert lower[[1, 2, 3], 0].tolist() == [-1, -1, -1]
    assert lower[0, 0] == pytest.approx(np.sin(1.0), abs=1e-14)


def test_mean_value_makes_images_of_small_boxes_tight():
    """Without it, `x - x` along two ways is as wide as `x` twice."""

    def map(x, p):
        return x - jnp.sin(x) * jnp.cos(x) ** 2 + x**3

    lower, upper = np.full((1, 1), 0.7), np.full((1, 1), 0.7001)
    widths = [
        float(np.diff(dynamics.Intervals(map, kind).images(lower, upper), axis=0).squeeze())
        for kind in (False, True)
    ]
    true = float(map(upper, None).item() - map(lower, None).item())
    assert true <= widths[1] < 1.001 * true
    assert widths[0] > 1.3 * true


@pytest.mark.parametrize(
    ("map", "lower", "upper", "image"),
    [
        (lambda x, p: jnp.log(x), 1.0, np.inf, (0.0, np.inf)),
        (lambda x, p: jnp.sqrt(x), -1.0, 4.0, (0.0, 2.0)),
        (lambda x, p: 1 / x, -1.0, 1.0, (-np.inf, np.inf)),
        (lambda x, p: x**2.5, 0.0, 4.0, (0.0, 32.0)),
        (lambda x, p: jnp.where(x > 0, jnp.nan, x), 1.0, 2.0, (-np.inf, np.inf)),
        (lambda x, p: jnp.minimum(x, jnp.inf), 1.0, 2.0, (1.0, 2.0)),
        (lambda x, p: x * p, 1.0, 2.0, (3.0, 6.0)),
        (lambda x, p: jax.nn.sigmoid(x), -np.inf, 0.0, (0.0, 0.5)),
        (lambda x, p: jnp.expm1(x) + jnp.log1p(x), 0.0, 0.0, (0.0, 0.0)),
    ],
)
def test_ends_of_domains(map, lower, upper, image):
    """Points without an image that is a real number are left out."""
    ends = dynamics.enclose(map, jnp.float64(3), jnp.array([lower]), jnp.array([upper]))
    assert ends[0] <= image[0]
    assert ends[1] >= image[1]
    np.testing.assert_allclose(np.ravel(ends), image, rtol=1e-14, atol=1e-14)


def test_derivatives_that_a_program_replaces_are_not_used():
    """The image of `x` with a derivative of 0 is not a point."""
    stopped = dynamics.Intervals(lambda x, p: jax.lax.stop_gradient(x))

    @jax.custom_jvp
    def flat(x):
        return 2 * x

    flat.defjvp(lambda x, along: (flat(*x), 0 * along[0]))
    replaced = dynamics.Intervals(lambda x, p: flat(x))
    for images, slope in ((stopped, 1.0), (replaced, 2.0)):
        lower, upper = images.images(np.zeros((1, 1)), np.ones((1, 1)))
        assert lower <= 0
        assert upper >= slope


def test_function_with_the_name_of_a_sine_keeps_its_values():
    @jax.jit
    def _sine(x):
        return 3 * x

    lower, upper = dynamics.Intervals(lambda x, p: _sine(x)).images(
        np.ones((1, 1)), np.ones((1, 1))
    )
    assert lower <= 3 <= upper


@pytest.mark.parametrize(
    ("map", "message"),
    [
        (lambda x, p: jax.scipy.special.erf(x), "the primitive erf of JAX has no rule"),
        (lambda x, p: jnp.array([1.0, 2.0])[x.astype(int)], "uncertain whole numbers"),
        (
            lambda x, p: x + (2 * jnp.floor(x).astype(int)).astype(x.dtype),
            "uncertain whole numbers",
        ),
        (lambda x, p: jnp.asarray(x, jnp.float32).astype(x.dtype), "numbers of float64"),
        (lambda x, p: lax.while_loop(lambda y: y[0] < 5, lambda y: y + 1, x), "primitive while"),
    ],
)
def test_programs_without_rules_are_refused(map, message):
    with pytest.raises(ValueError, match=message):
        dynamics.Intervals(map).images(np.zeros((1, 1)), np.ones((1, 1)))


OF_A_NUMBER = {
    "corner": lambda a: dynamics.enclose(lambda x, p: x * p, 2.0, a[None], jnp.array([3.0])),
    "parameter": lambda a: dynamics.enclose(lambda x, p: x * p, a, *jnp.ones((2, 1))),
    "closure": lambda a: dynamics.enclose(lambda x, p: jnp.sin(x * a), None, *jnp.ones((2, 1))),
}


@pytest.mark.parametrize("name", OF_A_NUMBER)
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_derivative_of_an_enclosure_is_refused(name, derivative):
    def lower(a):
        return OF_A_NUMBER[name](a)[0][0]

    assert jax.jit(lower)(2.0) != 0
    with pytest.raises(ValueError, match="enclose: expected no derivative; its"):
        derivative(lower)(2.0)


def halve(x, p):
    return 0.5 * x


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_traces_with_32_bits_are_refused_at_once_with_a_way_on(transform):
    def image(lower, upper):
        return dynamics.enclose(halve, None, lower, upper)

    low, high = np.array([[1.0]]), np.array([[2.0]])
    if transform is jax.jit:
        low, high = low[0], high[0]
    with jax.enable_x64(False):
        with pytest.raises(RuntimeError, match=r"enclose needs 64-bit .*jax_enable_x64"):
            transform(image)(low, high)
        plain = image(low.ravel(), high.ravel())
    np.testing.assert_allclose(plain, [[0.5], [1.0]], rtol=1e-15)
    np.testing.assert_allclose(transform(image)(low, high)[1].ravel(), [1.0], rtol=1e-15)


METHODS = {
    "enclose": lambda low, high: dynamics.enclose(halve, None, low[0], high[0]),
    "intervals": dynamics.Intervals(halve).images,
    "corners": dynamics.Corners(halve).images,
    "samples": dynamics.Samples(np.zeros((1, 2)), np.zeros((1, 2)), 0.5).images,
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("low", "high", "error"),
    [
        ([0.0, np.nan], [1.0, 1.0], "got nan and 1.0 in coordinate 1"),
        ([0.0, 0.0], [np.nan, 1.0], "got 0.0 and nan in coordinate 0"),
        ([2.0, 0.0], [1.0, 1.0], "got 2.0 and 1.0 in coordinate 0"),
    ],
)
def test_boxes_that_are_none_are_refused(method, low, high, error):
    with pytest.raises(ValueError, match=error) as raised:
        METHODS[method](np.array([low]), np.array([high]))
    assert "\n" not in str(raised.value)


def test_traced_boxes_that_are_none_have_no_image():
    lower, upper = np.array([[0.0], [np.nan], [2.0]]), np.ones((3, 1))
    own = jax.jit(jax.vmap(lambda a, b: dynamics.enclose(halve, None, a, b)))
    image = own(lower, upper)[1].ravel()
    np.testing.assert_allclose(image, [0.5, np.nan, np.nan], rtol=1e-15)
