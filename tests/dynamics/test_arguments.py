"""Arguments of the wrong kind are refused in one line, and equal numbers of other kinds work.

The checks run in a process of their own, because pytest checks the types of arguments itself.
"""

import re
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxcell import dynamics, mapping
from jaxcell.space import Box


BOX = Box([-1], [1], [10])


def halve(x, p):
    return 0.5 * x


def scaled(x, p):
    return p["rate"] * x


def rest(*_):
    return 0.0


# Calls with a whole number, and the least one.
CALLS = {
    "samples": (lambda n: dynamics.chain(halve, BOX, noise=0.1, samples=n), 1),
    "samples ": (lambda n: dynamics.unstable_set(halve, BOX, [[0.3]], samples=n), 2),
    "samples  ": (lambda n: dynamics.relative_attractor(halve, BOX, samples=n), 2),
    "levels": (lambda n: dynamics.relative_attractor(halve, BOX, levels=n), 0),
    "levels ": (lambda n: dynamics.refined(halve, dynamics.basins(halve, BOX), levels=n), 0),
    "follow": (lambda n: dynamics.basins(halve, BOX, follow=n), 0),
    "follow ": (lambda n: dynamics.images(halve, BOX, follow=n), 0),
    "seed": (lambda n: dynamics.basins(halve, BOX, seed=n), 0),
    "depth": (lambda n: dynamics.morse_sets(halve, BOX, depth=n), 0),
    "check": (lambda n: dynamics.morse_sets(halve, BOX, check=n), 0),
    "points": (lambda n: dynamics.Corners(halve, points=n), 1),
    "steps": (lambda n: dynamics.flow(halve, 0.1, n), 1),
    "steps ": (lambda n: dynamics.strobe(lambda t, x, p: x, 1.0, n), 1),
    "crossed": (lambda n: dynamics.flow(halve, 0.1, crossed=n), 1),
    "max_steps": (
        lambda n: dynamics.section(halve, rest, lift=rest, project=rest, dt=0.1, max_steps=n),
        1,
    ),
}


def check_whole_numbers(name):
    call, least = CALLS[name]
    for number in (least + 0.5, least - 1, "3", None, np.nan, np.inf):
        expected = rf"{name.strip()}: expected a whole number( from {least})?, got "
        with pytest.raises(ValueError, match=expected + re.escape(repr(number))) as raised:
            call(number)
        assert "\n" not in str(raised.value)
    call(least + 1.0)


WRONG = [
    (lambda: dynamics.flow(halve, np.inf, 1), "dt: expected a finite number above 0, got inf"),
    (lambda: dynamics.flow(halve, np.ones(2), 1), "dt: expected a number, got array"),
    (lambda: dynamics.basins(halve, BOX, by="cell"), "by: expected cells or orbits"),
    (lambda: dynamics.basins(halve, BOX, dtype="int32"), "dtype: expected float32 or float64"),
    (lambda: dynamics.Corners(halve, padding=np.nan), "padding: expected a finite number"),
    (lambda: dynamics.enclose(halve, None, np.zeros(2), np.ones(1)), "box: expected corners of"),
    (lambda: dynamics.enclose(halve, None, 0.0, 1.0), "lower: expected an array of numbers"),
    (lambda: Box([0], [1], [1.5]), "cells: expected whole numbers, got"),
    (lambda: mapping.SimpleMap(5, True), "image: expected the image of each cell"),
    (lambda: mapping.SimpleMap(np.zeros(3, int), True), "bumped: expected a mask of shape"),
]


def check_error(call, error):
    with pytest.raises(ValueError, match=error) as raised:
        call()
    assert "\n" not in str(raised.value)


def check_byte_order(kind):
    params = {"rate": np.array(0.5, kind)}
    np.testing.assert_array_equal(dynamics.images(scaled, BOX, params), dynamics.images(halve, BOX))
    assert dynamics.basins(scaled, BOX, params).period.tolist() == [1]
    dynamics.chain(scaled, BOX, params, noise=np.array([0.1], kind))
    reached = dynamics.unstable_set(scaled, BOX, np.array([[0.5]], kind), params)
    assert reached.tolist() == dynamics.unstable_set(halve, BOX, [[0.5]]).tolist()
    branches = dynamics.continuation(scaled, BOX, {"rate": np.array([0.5, 0.25], kind)})
    assert branches.count.tolist() == [1, 1]


def test_arguments_in_a_process_without_checks_of_types():
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    for each in CALLS:
        check_whole_numbers(each)
    for each in WRONG:
        check_error(*each)
    for each in (">f8", ">f4"):
        check_byte_order(each)
    for kind in (np.float32, ">f8", "<f8", np.int32, ">i4"):
        ends = np.array([1], kind), np.array([3], kind)
        image = dynamics.enclose(halve, None, *ends)
        np.testing.assert_allclose(image, [[0.5], [1.5]], rtol=1e-15)
        images = dynamics.Intervals(halve).images(*(end[None] for end in ends))
        np.testing.assert_allclose(images, [[[0.5]], [[1.5]]], rtol=1e-15)
    print("done")
