import shutil
import subprocess

import hypothesis.strategies as st
import numpy as np
import pytest


def _grid(width, height, *obstacles):
    free = np.ones((height, width), bool)
    for x0, y0, x1, y1 in obstacles:
        free[y0:y1, x0:x1] = False
    return free


# Two lab rooms in unit cells, obstacles as x0, y0, x1, y1. With 8 directions and collisions tested
# at end points only, they have the automata of Alam 2018, Tables 2.1 and 2.2.
_LAB_A = _grid(8, 4, (1, 1, 3, 3), (4, 0, 7, 3))
_LAB_B = _grid(6, 5, (2, 1, 5, 3), (0, 0, 1, 1), (4, 0, 6, 1), (0, 4, 1, 5), (5, 4, 6, 5))


def _bounce(free, directions, shift):
    """Compute the images and observations of a robot that turns if the next cell is not free."""
    height, width = free.shape
    number = np.full((height + 2, width + 2), -1)
    number[1:-1, 1:-1][free] = np.arange(free.sum())
    y, x = np.nonzero(free)
    image, observation = [], []
    for direction in range(directions):
        angle = 2 * np.pi * direction / directions
        dx, dy = np.floor(0.5 + np.round([np.cos(angle), np.sin(angle)], 9)).astype(int)
        target = number[y + dy + 1, x + dx + 1]
        turned = (direction + shift) % directions * x.size + np.arange(x.size)
        image.append(np.where(target >= 0, direction * x.size + target, turned))
        observation.append(target < 0)
    return np.concatenate(image).astype(np.int32), np.concatenate(observation)


@pytest.fixture(scope="session")
def bounce():
    """A function that computes the bounce map of a mask of free cells, directions, and a turn."""
    return _bounce


@pytest.fixture(scope="session")
def labs():
    """The bounce maps of both lab rooms by room and angle in degrees."""
    return {
        (room, angle): _bounce(free, 8, angle // 45)
        for room, free in (("a", _LAB_A), ("b", _LAB_B))
        for angle in (45, 135)
    }


@st.composite
def _arbitrary_graphs(draw):
    cells = draw(st.integers(1, 14))
    image = draw(st.lists(st.integers(0, cells - 1), min_size=cells, max_size=cells))
    observation = draw(st.lists(st.booleans(), min_size=cells, max_size=cells))
    return np.array(image, np.int32), np.array(observation)


@st.composite
def _bounce_graphs(draw):
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    flags = draw(st.lists(st.booleans(), min_size=height * width, max_size=height * width))
    free = np.array(flags).reshape(height, width)
    free[0, 0] = True
    directions = draw(st.sampled_from([1, 3, 4, 8]))
    return _bounce(free, directions, draw(st.integers(0, directions - 1)))


@pytest.fixture(scope="session")
def graphs():
    """A strategy for the images and observations of arbitrary maps and of bounce maps."""
    return st.one_of(_arbitrary_graphs(), _bounce_graphs())


@pytest.fixture
def compiled(tmp_path):
    """A function that compiles a C program with a header `lab.h`.

    It returns a function that runs the program with a string as standard input.
    """

    def compile(header, source, *flags, compiler="cc"):
        if shutil.which(compiler) is None:
            pytest.skip(f"no {compiler} to compile with")
        (tmp_path / "lab.h").write_text(header)
        # An Arduino sketch is C++.
        language = ["-std=c99"] if compiler == "cc" else ["-x", "c++", "-std=c++11"]
        strict = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{tmp_path}", *flags]
        program = tmp_path / "program"
        subprocess.run([compiler, *language, *strict, source, "-o", program], check=True)
        return lambda string: subprocess.run(
            [program], input=string, capture_output=True, text=True, check=False
        )

    return compile


@pytest.fixture
def outputs(compiled, tmp_path):
    """A function that compiles a header, and returns a function from observations to outputs.

    The outputs are, after each observation, the colour, whether the robot is localized, whether the
    map is refuted and, for a policy, the turn and the uncertainty.
    """
    source = tmp_path / "main.c"
    source.write_text(_MAIN)

    def outputs(header, compiler="cc"):
        run = compiled(header, source, compiler=compiler)
        return lambda string: [
            tuple(map(int, line.split())) for line in run(string).stdout.splitlines()
        ]

    return outputs


_MAIN = r"""
#include <stdio.h>
#include "lab.h"
int main(void) {
    lab_state state = LAB_START;
    int c;
    while ((c = getchar()) != EOF) {
        state = lab_next(state, (uint8_t)(c - '0'));
        printf("%lu %d %d", (unsigned long)lab_color(state), lab_localized(state),
               lab_refuted(state));
#ifdef LAB_NO_TURN
        printf(" %d %lu", (int)lab_turn(state), (unsigned long)lab_uncertainty(state));
#endif
        printf("\n");
    }
    return 0;
}
"""
