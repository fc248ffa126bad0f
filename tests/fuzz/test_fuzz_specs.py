"""Damaged specifications of sweeps, and specifications with any numbers."""

import math

import pytest
from hypothesis import example, given, strategies as st
from mutations import cases, damaged, place, reads_or_refuses

from jaxcell.sweep import Spec


GRID = b"""task = "stub:one"
seed = 7
chunk = {bounce = 4, cell = 2}

[fixed]
map = "data/maps/lab_a.json"
wide = true

[grid]
bounce = {start = 0, stop = 180, step = 15}
cell = [0.25, 0.5, 1.0]
error = {start = 0.0, stop = 1.0, num = 5}
replicate = {count = 3}
"""
LIST = b"""task = "stub:one"
chunk = 100

[list]
name = ["a", "b", "c"]
size = [1, 2, 3]
"""
RANDOM = b"""task = "stub:one"

[random]
samples = 20
a = {uniform = [0, 1]}
b = {loguniform = [1e-3, 1.0]}
c = {normal = [0.0, 2.0]}
d = {integers = [0, 10]}
e = {choice = ["x", "y"]}
"""
DESIGN = RANDOM.replace(b"samples = 20", b'samples = 16\ndesign = "saltelli"')
SPECS = {"grid.toml": GRID, "list.toml": LIST, "random.toml": RANDOM, "design.toml": DESIGN}


def use(path):
    """Read a specification, and its last chunk."""
    spec = Spec.load(path)
    chunk = spec.chunk(spec.chunk_count - 1)
    batch = spec.batch(chunk)
    assert len(batch) == len(spec.parameters)
    assert all(values.size == math.prod(chunk.shape) > 0 for values in batch.values())


def test_undamaged_specifications_are_read(tmp_path):
    for name, content in SPECS.items():
        assert reads_or_refuses(use, place(tmp_path, name, content))


@cases()
@given(damaged(SPECS))
def test_damaged_specifications_are_read_or_refused(tmp_path, file):
    reads_or_refuses(Spec.load, place(tmp_path, *file))


numbers = st.sampled_from(
    [
        *("0", "-1", "1", "2", "3", "0.5", "1e-9", "-1e-300", "1e300", "-1.7e308", "inf", "-inf"),
        *("nan", "99999999", "100000000", "100000001", "9223372036854775807", "true", "'x'"),
        *("9223372036854775808", "-9223372036854775808", "1_000_000_000_000", "[]", "[0,1]", "{}"),
        *("1979-05-27", "1979-05-27T07:32:00Z", "07:32:00"),
    ]
) | st.integers(-(10**30), 10**30).map(str)
ranges = st.one_of(
    st.builds("{{start={}, stop={}, step={}}}".format, numbers, numbers, numbers),
    st.builds("{{start={}, stop={}, num={}}}".format, numbers, numbers, numbers),
    st.builds("{{count={}}}".format, numbers),
    st.builds("[{}, {}]".format, numbers, numbers),
)
draws = st.builds(
    "{{{}=[{}, {}]}}".format,
    st.sampled_from(["uniform", "loguniform", "normal", "integers", "choice", "x"]),
    numbers,
    numbers,
)
designs = st.sampled_from(
    ["", *(f"design = '{name}'" for name in ("sobol", "latin_hypercube", "saltelli", "x"))]
)


@cases()
@given(st.lists(ranges | numbers, min_size=1, max_size=3), numbers, numbers)
@example(["{start=-1.7e308, stop=1.7e308, step=1}"], "1", "0")
@example(["{start=0, stop=1, step=5e-324}"], "1", "0")
@example(["{start=1, stop=0, step=5e-324}"], "1", "0")
@example([f"{{start=0, stop={10**30}, step={10**29}}}"], "1", "0")
@example(["{start=-1.7e308, stop=1.7e308, num=3}"], "1", "0")
@example(["[0.5, " + "1" * 400 + "]"], "1", "0")
def test_any_grids_are_read_or_refused(tmp_path, grid, chunk, seed):
    rows = "\n".join(f"p{i} = {values}" for i, values in enumerate(grid))
    text = f'task = "stub:one"\nchunk = {chunk}\nseed = {seed}\n[grid]\n{rows}\n'
    reads_or_refuses(Spec.load, place(tmp_path, "s.toml", text.encode()))


@cases()
@given(st.lists(draws | numbers, min_size=1, max_size=3), numbers, numbers, designs)
def test_any_random_samples_are_read_or_refused(tmp_path, random, samples, chunk, design):
    rows = "\n".join(f"p{i} = {values}" for i, values in enumerate(random))
    text = f'task = "stub:one"\nchunk = {chunk}\n[random]\nsamples = {samples}\n{rows}\n{design}'
    reads_or_refuses(Spec.load, place(tmp_path, "s.toml", text.encode()))


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 50_000, "a." * 5000 + "b = 1", "[" + "a." * 5000 + "b]\n", "=" * 9]
)
def test_deeply_nested_toml_is_refused(tmp_path, text):
    assert not reads_or_refuses(Spec.load, place(tmp_path, "s.toml", text.encode()))
