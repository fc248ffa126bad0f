"""Interval images are compared with Arb, by exact values to 60 digits at points of boxes."""

import flint
import jax.numpy as jnp
import numpy as np
import pytest

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
    "kinks": lambda m, x, y: (m.absolute(x - y), m.maximum(x, y * y) - m.minimum(x, 0.5 * y)),
    "branches": lambda m, x, y: (m.where(x > y, x * y, x - 2 * y), m.where(x <= 1.0, x, -y)),
    "steps": lambda m, x, y: (m.mod(x, 0.7), m.floor(3 * y) * x),
    "small": lambda m, x, y: ((x - 1.0) * 1e-170 * (y * 1e-170), x * 1e-200 / (1e-190 + y * y)),
}


def of_jax(name):
    return lambda x, p: jnp.stack(MAPS[name](jnp, x[0], x[1]))


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


@pytest.mark.parametrize("mean_value", [False, True])
@pytest.mark.parametrize("name", MAPS)
def test_images_of_boxes_contain_exact_images_of_their_points(name, mean_value):
    rng = np.random.default_rng(0)
    lower, upper = boxes(rng, BOXES)
    images = dynamics.Intervals(of_jax(name), mean_value).images(lower, upper)
    assert violations(name, lower, upper, images, rng) == 0
