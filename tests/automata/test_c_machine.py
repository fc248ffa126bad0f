import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from jaxcell.automata import (
    Filter,
    MooreMachine,
    fewest_bytes,
    machine_bytes,
    machine_to_c_header,
    smallest,
    subset_construction,
    to_dot,
    to_json,
)


pytest.importorskip("pysat.solvers")

MAIN = """
#include <stdio.h>
#include "lab.h"
int main(void) {
    lab_state state = LAB_START;
    int c;
    while ((c = getchar()) != EOF) {
        state = lab_next(state, (uint8_t)(c - '0'));
        printf("%lu %d %d\\n", (unsigned long)lab_color(state), lab_localized(state),
               lab_refuted(state));
    }
    return 0;
}
"""


def words(graph, count=20, length=60):
    """Observations of robots from random cells."""
    image, observation = graph
    for cell in np.random.default_rng(0).integers(0, image.size, count).tolist():
        word = []
        for _ in range(length):
            word.append(int(observation[cell]))
            cell = int(image[cell])
        yield word


@pytest.mark.parametrize("compiler", ["cc", "c++"])
@pytest.mark.parametrize("runs", [False, True])
def test_compiled_machine_gives_the_colours_of_the_filter(labs, tmp_path, compiler, runs):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} to compile with")
    graph = labs["a", 135]
    filter = Filter.of(subset_construction(*graph))
    machine = smallest(MooreMachine.of(filter, runs=runs)).machine
    (tmp_path / "lab.h").write_text(machine_to_c_header(machine, name="lab"))
    (tmp_path / "main.c").write_text(MAIN)
    standard = "-std=c99" if compiler == "cc" else "-std=c++11"
    language = [] if compiler == "cc" else ["-x", "c++"]
    strict = [standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    source = [*language, str(tmp_path / "main.c"), "-o", str(tmp_path / "main")]
    subprocess.run([compiler, *strict, *source], check=True)
    for word in words(graph):
        run = subprocess.run(
            [tmp_path / "main"], input="".join(map(str, word)), capture_output=True, text=True
        )
        lines = [list(map(int, line.split())) for line in run.stdout.splitlines()]
        # A machine of runs has the output of the last bump.
        colors, now = [], 1
        for observation, color in zip(word, filter.run(word).colors[1:].tolist(), strict=True):
            now = color if observation or not runs else now
            colors.append([now, int(now > 1), 0])
        assert lines == colors


def test_tables_have_the_counted_bytes(labs):
    for graph in labs.values():
        filter = Filter.of(subset_construction(*graph))
        sizes = []
        for runs in (False, True):
            machine = smallest(MooreMachine.of(filter, runs=runs)).machine
            tables = re.findall(
                r"static const uint(\d+)_t \w+\[(\d+)\](\[2\])?", machine_to_c_header(machine)
            )
            sizes.append(sum(int(b) // 8 * int(n) * (2 if pair else 1) for b, n, pair in tables))
            assert machine_bytes(machine) == sizes[-1]
        assert machine_bytes(fewest_bytes(filter).machine) == min(sizes)


def test_machine_becomes_a_graph_and_json(labs):
    machine = smallest(Filter.of(subset_construction(*labs["a", 45]))).machine
    written = json.loads(to_json(machine))
    assert written["transition"] == machine.transition.tolist()
    assert written["color"] == machine.color.tolist()
    dot = to_dot(machine)
    assert dot.count(" -> ") == np.count_nonzero(machine.transition >= 0)
    assert dot.count('fillcolor="') == np.count_nonzero(machine.color > 1)
