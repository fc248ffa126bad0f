import re
import shutil
import subprocess
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given

from jaxcell.automata import Filter, minimize, subset_construction, to_c_header


EXAMPLE = Path(__file__).parents[2] / "experiments" / "c_filter_example.c"
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]


def compiled(folder, filter, *flags, compiler="cc", standard="c99"):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} to compile with")
    (folder / "lab.h").write_text(to_c_header(filter, name="lab"))
    program = folder / "example"
    language = ["-x", "c++"] if compiler == "c++" else []
    source = [*language, str(EXAMPLE), f"-I{folder}", "-o", str(program)]
    subprocess.run([compiler, f"-std={standard}", *STRICT, *flags, *source], check=True)
    return program


def colors_of(program, string):
    run = subprocess.run([program], input=string, capture_output=True, text=True, check=False)
    return run, [int(line) for line in run.stdout.split()]


def assert_agrees(program, filter, graph, count=15):
    """The program prints the filter's colours on strings that robots sense and on random ones."""
    rng = np.random.default_rng(0)
    image, observation = graph
    trapping = filter.with_trap()
    for number in range(2 * count):
        string, cell = "", int(rng.integers(image.size))
        for _ in range(50):
            bit = observation[cell] if number < count else rng.random() < 0.5
            string, cell = string + str(int(bit)), int(image[cell])
        run = trapping.run(string)
        expected = run.colors.copy()
        if not filter.open_world:
            expected[run.states == trapping.trap] = 0
        result, colors = colors_of(program, string)
        assert colors == expected.tolist()
        last = int(run.states[-1])
        assert result.returncode == (run.refuted_at is not None)
        if run.refuted_at is None and run.localized_at is not None:
            assert result.stderr == f"in one of {filter.uncertainty[last]} configurations\n"
        else:
            assert result.stderr == ""


@pytest.mark.parametrize("open_world", [False, True])
def test_compiled_example_gives_the_colours_of_the_filter(labs, tmp_path, open_world):
    for graph in labs.values():
        filter = Filter.of(subset_construction(*graph), open_world=open_world)
        assert_agrees(compiled(tmp_path, filter), filter, graph)
    assert_agrees(compiled(tmp_path, minimize(filter)), minimize(filter), graph)


def test_header_compiles_as_cpp(labs, tmp_path):
    # An Arduino sketch is C++.
    graph = labs["b", 45]
    filter = Filter.of(subset_construction(*graph))
    assert_agrees(compiled(tmp_path, filter, compiler="c++", standard="c++11"), filter, graph, 3)


# The filter has about twice as many states.
@pytest.mark.parametrize(("cells", "width"), [(100, 8), (1000, 16), (40_000, 32)])
def test_tables_of_every_width_are_read_from_flash(tmp_path, cells, width):
    # Stands for the AVR library: flash is read through these macros only.
    (tmp_path / "avr").mkdir()
    (tmp_path / "avr" / "pgmspace.h").write_text(
        "#define PROGMEM __attribute__((aligned(8)))\n"
        "#define pgm_read_byte(p) (*(const uint8_t *)(p))\n"
        "#define pgm_read_word(p) (*(const uint16_t *)(p))\n"
        "#define pgm_read_dword(p) (*(const uint32_t *)(p))\n"
    )
    rng = np.random.default_rng(0)
    image = ((np.arange(cells) + 1) % cells).astype(np.int32)
    graph = image, rng.random(cells) < 0.5
    filter = Filter.of(subset_construction(*graph), open_world=True)
    assert 2 ** (width // 2) <= len(filter.transition) < 2**width
    program = compiled(tmp_path, filter, "-DJAXCELL_PROGMEM")
    assert f"typedef uint{width}_t lab_state;" in (tmp_path / "lab.h").read_text()
    assert_agrees(program, filter, graph, 3)


@pytest.mark.parametrize(("states", "width"), [(255, 8), (256, 16), (65535, 16), (65536, 32)])
def test_state_type_has_room_for_impossible(states, width):
    # A circle where the robot senses nothing: all its states but the start by hand.
    transition = np.full((states, 2), -1, np.int32)
    transition[:-1, 0] = np.arange(1, states)
    transition[-1, 0] = 0
    filter = Filter(
        transition=transition,
        uncertainty=np.ones(states, np.int32),
        offsets=np.arange(states + 1),
        members=np.zeros(states, np.int32),
    )
    text = to_c_header(filter)
    assert f"typedef uint{width}_t filter_state;" in text
    assert re.search(rf"#define filter_IMPOSSIBLE {2**width - 1}ul?$", text, re.M | re.I)


@given(name=st.text())
@example(name="*/ int")
@example(name="\\\n1")
@example(name="_Bool")
def test_any_name_makes_identifiers(labs, name):
    text = to_c_header(Filter.of(subset_construction(*labs["a", 45])), name=name)
    prefix = re.search(r"^typedef uint8_t (\w+)_state;$", text, re.MULTILINE)[1]
    assert re.fullmatch("[A-Za-z][A-Za-z0-9_]*", prefix)
    plain = to_c_header(Filter.of(subset_construction(*labs["a", 45])), name="filter")
    assert text == plain.replace("filter_", f"{prefix}_").replace("FILTER_", f"{prefix.upper()}_")
