import json
import re

import numpy as np
import pytest

from jaxcell import automata
from jaxcell.automata import Filter, MooreMachine, smallest, subset_construction


pytest.importorskip("pysat.solvers")


@pytest.mark.parametrize("compiler", ["cc", "c++"])
@pytest.mark.parametrize("runs", [False, True])
def test_compiled_machine_gives_the_colours_of_the_filter(labs, outputs, compiler, runs):
    image, observation = labs["a", 135]
    filter = Filter.of(subset_construction(image, observation))
    machine = smallest(MooreMachine.of(filter, runs=runs)).machine
    run = outputs(automata.machine_to_c_header(machine, name="lab"), compiler)
    for cell in np.random.default_rng(0).integers(0, image.size, 20).tolist():
        word = ""
        for _ in range(60):
            word, cell = word + str(int(observation[cell])), int(image[cell])
        # A machine that reads runs keeps the output of the last bump.
        expected, now = [], 1
        for digit, color in zip(word, filter.run(word).colors[1:].tolist(), strict=True):
            now = color if digit == "1" or not runs else now
            expected.append((now, now > 1, 0))
        assert run(word) == expected


def test_tables_have_the_counted_bytes(labs):
    for graph in labs.values():
        filter = Filter.of(subset_construction(*graph))
        sizes = []
        for runs in (False, True):
            machine = smallest(MooreMachine.of(filter, runs=runs)).machine
            tables = re.findall(
                r"static const uint(\d+)_t \w+\[(\d+)\](\[2\])?",
                automata.machine_to_c_header(machine),
            )
            sizes.append(sum(int(b) // 8 * int(n) * (2 if pair else 1) for b, n, pair in tables))
            assert automata.machine_bytes(machine) == sizes[-1]
        assert automata.machine_bytes(automata.fewest_bytes(filter).machine) == min(sizes)


def test_machine_becomes_a_graph_and_json(labs):
    machine = smallest(Filter.of(subset_construction(*labs["a", 45]))).machine
    written = json.loads(automata.to_json(machine))
    assert written["transition"] == machine.transition.tolist()
    assert written["color"] == machine.color.tolist()
    dot = automata.to_dot(machine)
    assert dot.count(" -> ") == np.count_nonzero(machine.transition >= 0)
    assert dot.count('fillcolor="') == np.count_nonzero(machine.color > 1)
