import re
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given

from jaxcell.automata import Filter, minimize, subset_construction, to_c_header


EXAMPLE = Path(__file__).parents[2] / "experiments" / "c_filter_example.c"


def assert_agrees(run, filter, graph, count=15):
    """Compare the printed colours on strings that robots sense, and on random strings."""
    rng = np.random.default_rng(0)
    image, observation = graph
    trapping = filter.with_trap()
    for number in range(2 * count):
        string, cell = "", int(rng.integers(image.size))
        for _ in range(50):
            bit = observation[cell] if number < count else rng.random() < 0.5
            string, cell = string + str(int(bit)), int(image[cell])
        expected = trapping.run(string)
        colors = expected.colors.copy()
        if not filter.open_world:
            colors[expected.states == trapping.trap] = 0
        result = run(string)
        assert list(map(int, result.stdout.split())) == colors.tolist()
        assert result.returncode == (expected.refuted_at is not None)
        localized = expected.refuted_at is None and expected.localized_at is not None
        uncertainty = trapping.uncertainty[expected.states[-1]]
        assert result.stderr == f"in one of {uncertainty} configurations\n" * localized


@pytest.mark.parametrize(("open_world", "compiler"), [(False, "cc"), (True, "cc"), (False, "c++")])
def test_compiled_example_gives_the_colours_of_the_filter(labs, compiled, open_world, compiler):
    for graph in labs.values() if compiler == "cc" else [labs["b", 45]]:
        filter = Filter.of(subset_construction(*graph), open_world=open_world)
        for header in (filter, minimize(filter)):
            run = compiled(to_c_header(header, name="lab"), EXAMPLE, compiler=compiler)
            assert_agrees(run, header, graph)


# The filter has about twice as many states.
@pytest.mark.parametrize(("cells", "width"), [(100, 8), (1000, 16), (40_000, 32)])
def test_tables_of_every_width_are_read_from_flash(tmp_path, compiled, cells, width):
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
    header = to_c_header(filter, name="lab")
    assert f"typedef uint{width}_t lab_state;" in header
    assert_agrees(compiled(header, EXAMPLE, "-DJAXCELL_PROGMEM"), filter, graph, 3)


@pytest.mark.parametrize(("states", "width"), [(255, 8), (256, 16), (65535, 16), (65536, 32)])
def test_state_type_has_room_for_impossible(states, width):
    # The robot goes round in a circle without a bump.
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
    filter = Filter.of(subset_construction(*labs["a", 45]))
    text, plain = to_c_header(filter, name=name), to_c_header(filter, name="filter")
    prefix = re.search(r"^typedef uint8_t (\w+)_state;$", text, re.MULTILINE)[1]
    assert re.fullmatch("[A-Za-z][A-Za-z0-9_]*", prefix)
    assert text == plain.replace("filter_", f"{prefix}_").replace("FILTER_", f"{prefix.upper()}_")
