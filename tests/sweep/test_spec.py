import itertools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.sweep import Spec, run_sweep


def load(folder, text):
    path = folder / "spec.toml"
    path.write_text(text)
    return Spec.load(path)


def values(folder, text):
    """The values of the one parameter `x` of a specification."""
    (parsed,) = load(folder, f'task = "a:b"\n{text}').parameters
    assert parsed.name == "x"
    return parsed.values


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("[3, 1, 2]", np.array([3, 1, 2])),
        ("[1, 2.5]", np.array([1.0, 2.5])),
        ("[true, false]", np.array([True, False])),
        ('["a.json", "b.json"]', np.array(["a.json", "b.json"])),
        ("{count = 3}", np.arange(3)),
        ("{start = 0, stop = 10, step = 3}", np.array([0, 3, 6, 9])),
        ("{start = 5, stop = 0, step = -2}", np.array([5, 3, 1])),
        # A third of 0.1 is more than it, so that 0.3 is less than three times 0.1.
        ("{start = 0, stop = 0.3, step = 0.1}", np.array([0, 0.1, 0.2])),
        ("{start = 0, stop = 1, num = 5}", np.array([0, 0.25, 0.5, 0.75, 1])),
    ],
)
def test_grid_values(tmp_path, given, expected):
    parsed = values(tmp_path, f"[grid]\nx = {given}")
    assert parsed.dtype == expected.dtype
    np.testing.assert_array_equal(parsed, expected)


@pytest.mark.parametrize(
    ("kind", "inside", "mean"),
    [
        ("{uniform = [2, 4]}", lambda x: (x >= 2) & (x < 4), 3),
        ("{loguniform = [1, 100]}", lambda x: (x >= 1) & (x <= 100), 99 / math.log(100)),
        ("{normal = [5, 2]}", lambda x: np.abs(x - 5) < 12, 5),
        ("{integers = [1, 6]}", lambda x: np.isin(x, np.arange(1, 7)), 3.5),
        ("{choice = [1, 10]}", lambda x: np.isin(x, [1, 10]), 5.5),
    ],
)
def test_random_values_have_their_distribution(tmp_path, kind, inside, mean):
    parsed = values(tmp_path, f"[random]\nsamples = 4000\nx = {kind}")
    assert inside(parsed).all()
    assert abs(parsed.mean() - mean) < 5 * parsed.std() / math.sqrt(4000)


def test_random_values_depend_on_the_seed_and_their_name_alone(tmp_path):
    def drawn(head, more=""):
        text = f'task = "a:b"\n{head}\n[random]\n{more}samples = 9\nx = {{uniform = [0, 1]}}'
        spec = load(tmp_path, text)
        return next(one.values for one in spec.parameters if one.name == "x")

    first = drawn("")
    np.testing.assert_array_equal(first, drawn("chunk = 2", "w = {normal = [0, 1]}\n"))
    assert (first != drawn("seed = 1")).all()


def test_parameters_give_the_dimensions_in_their_order(tmp_path):
    text = 'task = "a:b"\n[grid]\nb = [1, 2]\na = {count = 3}\n[list]\nx = [1, 1]\ny = ["p", "q"]'
    spec = load(tmp_path, text)
    assert spec.dimensions == {"b": 2, "a": 3, "member": 2}
    assert spec.members == 12
    assert [(one.name, one.dimension) for one in spec.parameters] == [
        ("b", "b"),
        ("a", "a"),
        ("x", "member"),
        ("y", "member"),
    ]


@given(
    sizes=st.lists(st.integers(1, 7), min_size=1, max_size=3),
    chunk=st.integers(1, 40),
    table=st.booleans(),
    data=st.data(),
)
def test_chunks_hold_every_member_once(tmp_path_factory, sizes, chunk, table, data):
    names = "pqr"[: len(sizes)]
    given_chunk = str(chunk)
    if table:
        some = data.draw(st.sets(st.sampled_from(names)))
        lengths = {name: data.draw(st.integers(1, 9)) for name in some}
        given_chunk = f"{{{', '.join(f'{name} = {size}' for name, size in lengths.items())}}}"
    grid = "\n".join(
        f"{name} = {{count = {size}}}" for name, size in zip(names, sizes, strict=True)
    )
    folder = tmp_path_factory.mktemp("spec")
    spec = load(folder, f'task = "a:b"\nchunk = {given_chunk}\n[grid]\n{grid}')
    length = math.prod(spec.lengths.values())
    if table:
        assert all(
            spec.lengths[name] == min(lengths.get(name, 9), size)
            for name, size in spec.dimensions.items()
        )
    else:
        assert length <= chunk
    seen = []
    for number in range(spec.chunk_count):
        part = spec.chunk(number)
        assert part.number == number
        batch = spec.batch(part)
        rows = list(zip(*(batch[name].tolist() for name in names), strict=True))
        assert 0 < len(rows) <= length
        assert rows == list(itertools.product(*(range(one.start, one.stop) for one in part.region)))
        for place, row in enumerate(rows):
            index = spec.index(part, place)
            assert tuple(index.values()) == row
            assert spec.member(index) == index
        seen += rows
    assert sorted(seen) == list(itertools.product(*map(range, sizes)))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("task = 3", "task: expected the name of a task"),
        ('task = "a"\nsed = 1', "unknown field 'sed'"),
        ('task = "a"\nseed = -1', "seed: expected an integer from 0"),
        ('task = "a"\nseed = true', "seed: expected"),
        ('task = "a"', "no parameters; expected a table"),
        ('task = "a"\ngrid = 3', "grid: expected a table"),
        ("[grid]\nx = []", "grid.x: expected a list of values"),
        ('[grid]\nx = "abc"', "grid.x: expected a list of values, got 'abc'"),
        ("[grid]\nx = [1, nan]", "grid.x: expected finite numbers"),
        ('[grid]\nx = [1, "a"]', "grid.x: expected finite numbers, or strings"),
        ("[grid]\nx = [1, true]", "grid.x: expected finite numbers, or strings, or booleans"),
        ("[grid]\nx = [[1], [2]]", "grid.x: expected finite numbers"),
        ("[grid]\nx = [1, 2, 1]", "grid.x: expected different values"),
        ("[grid]\nx = [9223372036854775808]", "grid.x: expected integers of 64 bits"),
        ("[grid]\nx = {count = 0}", "grid.x: count: expected a number from 1"),
        ("[grid]\nx = {start = 0, stop = 3}", "the fields start, stop"),
        ("[grid]\nx = {start = 0, stop = 3, step = 0}",
         "grid.x: there are no values from 0 up to 3"),
        ("[grid]\nx = {start = 0, stop = 3, step = -1}", "grid.x: there are no values"),
        ("[grid]\nx = {start = 0, stop = inf, num = 3}", "grid.x: stop: expected a finite number"),
        ("[grid]\nx = {start = 0, stop = 1e30, step = 1}", "grid.x: the number of values"),
        ("[grid]\nmember = [1]", "'member': expected a name"),
        ("[grid]\nstatus = [1]", "'status': expected a name"),
        ('[grid]\n"a/b" = [1]', "'a/b': expected a name of letters"),
        ("[list]\nx = [1]\ny = [1, 2]", r"\[list\]: expected lists of one length, got x 1, y 2"),
        ("[grid]\nx = [1]\n[list]\nx = [1]", "x is in two of the tables"),
        ("[list]\nx = [1]\n[random]\nsamples = 1\ny = {uniform = [0, 1]}",
         "expected only one of them"),
        ("[random]\nx = {uniform = [0, 1]}", "random.samples: expected a number from 1"),
        ("[random]\nsamples = 3", r"\[random\]: expected a distribution"),
        ("[random]\nsamples = 3\nx = {gauss = [0, 1]}", "random.x: expected one of {uniform}"),
        ("[random]\nsamples = 3\nx = {uniform = [1]}", "random.x: uniform: expected two"),
        ("[random]\nsamples = 3\nx = {uniform = [1, 0]}", "a low and then a high end"),
        ("[random]\nsamples = 3\nx = {normal = [0, -1]}", "a deviation of at least 0"),
        ("[random]\nsamples = 3\nx = {loguniform = [0, 1]}", "expected positive ends"),
        ("[random]\nsamples = 3\nx = {integers = [0, 1.5]}", "integers of 64 bits"),
        ("[grid]\nx = [1]\n[fixed]\nx = 3", "fixed.x is also a parameter"),
        ("chunk = 0\n[grid]\nx = [1]", "chunk: expected a number of members from 1, got 0"),
        ("[grid]\nx = [1]\n[chunk]\ny = 3", "chunk.y: expected a dimension, x"),
        ("[grid]\nx = [1]\n[chunk]\nx = 0", "chunk.x: expected a number of members"),
        ("chunk = 1\n[grid]\nx = {count = 1000001}", "chunk: 1000001 chunks"),
        ("task = ", "Invalid value"),
    ],
)  # fmt: skip
def test_the_error_of_a_specification_names_the_field(tmp_path, text, named):
    if not text.startswith("task"):
        text = 'task = "a:b"\n' + text
    with pytest.raises(ValueError, match=named) as caught:
        load(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'spec.toml'}: ")
    assert "\n" not in str(caught.value)


def test_other_files_are_refused_as_specifications(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        Spec.load(tmp_path / "spec.toml")
    with pytest.raises(ValueError, match="got a directory"):
        Spec.load(tmp_path)
    (tmp_path / "spec.toml").write_bytes(b"task = '\xff'")
    with pytest.raises(ValueError, match=r"spec\.toml: 'utf-8' codec"):
        Spec.load(tmp_path / "spec.toml")


def test_differences_of_fields_are_described(tmp_path):
    old = load(tmp_path, 'task = "a:b"\n[fixed]\nq = 1\n[grid]\nx = {count = 1000}\ny = [1, 2]')
    assert old.differences(old) == []
    comments = load(tmp_path, 'task = "a:b"  # !\nfixed.q = 1\n[grid]\nx.count = 1000\ny = [1,2]')
    assert old.differences(comments) == []
    new = load(tmp_path, 'task = "a:b"\nseed = 0\n[fixed]\nq = 1.0\n[grid]\nx = [3]\ny = [1, 2]')
    assert old.differences(new) == [
        "fixed.q: 1 there, 1.0 here",
        "grid.x: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 1... there, [3] here",
        "seed: nothing there, 0 here",
    ]
    turned = load(tmp_path, 'task = "a:b"\n[fixed]\nq = 1\n[grid]\ny = [1, 2]\nx = {count = 1000}')
    assert old.differences(turned) == ["grid: in the order x, y there"]
    long = ", ".join(map(str, range(1000)))
    first = load(tmp_path, f'task = "a:b"\n[grid]\nx = [{long}]')
    second = load(tmp_path, f'task = "a:b"\n[grid]\nx = [{long}, 1000]')
    assert first.differences(second) == [
        "grid.x: ..., 996, 997, 998, 999] there, ..., 996, 997, 998, 999, 1000] here"
    ]
    first = load(tmp_path, f'task = "a:b"\nfixed.q = [{long}]\n[grid]\nx = [1]')
    second = load(tmp_path, f'task = "a:b"\nfixed.q = [{long}.5]\n[grid]\nx = [1]')
    (message,) = first.differences(second)
    assert len(message) < 200
    assert "999] there" in message
    assert "999.5] here" in message


@pytest.mark.parametrize(
    ("old", "new", "messages"),
    [
        ("[grid]\nx = [1, 2]", "[grid]\nx = [2, 1]", ["grid.x: [1, 2] there, [2, 1] here"]),
        ("[grid]\nx = [1]", "[grid]\nx = [1.0]", ["grid.x: [1] there, [1.0] here"]),
        ("[grid]\nx = [1]", "[list]\nx = [1]",
         ["grid.x: [1] there, nothing here", "list.x: nothing there, [1] here"]),
        ("[grid]\nx = [0, 1, 2]", "[grid]\nx = {count = 3}", []),
    ],
)  # fmt: skip
def test_differences_of_parameters_are_described(tmp_path, old, new, messages):
    first = load(tmp_path, f'task = "a:b"\n{old}')
    second = load(tmp_path, f'task = "a:b"\n{new}')
    assert first.differences(second) == messages


@pytest.mark.parametrize(
    ("old", "new", "places"),
    [
        ("[grid]\nx = [1, 2]", "[grid]\nx = [3, 2, 1]", {"x": [-1, 1, 0]}),
        ("[grid]\nx = [1, 2]", "[grid]\nx = [1, 3]", None),
        ("[grid]\nx = [1]", "[grid]\nx = [1]\ny = [1]", None),
        ("[grid]\nx = [1]\ny = [1]", "[grid]\ny = [1, 2]\nx = [1]", None),
        ("[grid]\nx = [1]\n[fixed]\nq = 1", "[grid]\nx = [1, 2]\n[fixed]\nq = 2", None),
        ("[list]\nx = [1, 1]\ny = [2, 2]", "[list]\ny = [2, 3, 2]\nx = [1, 1, 1]",
         {"member": [0, -1, 1]}),
    ],
)  # fmt: skip
def test_places_of_the_members_of_a_smaller_sweep(tmp_path, old, new, places):
    first = load(tmp_path, f'task = "a:b"\n{old}')
    mapped = load(tmp_path, f'task = "a:b"\n{new}').places_in(first)
    assert (mapped and {name: some.tolist() for name, some in mapped.items()}) == places


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'task = "rooms"\nresults = ["nosuch"]\n[grid]\nroom = {count = 3}\nbounce = [45]',
            "nosuch",
        ),
        ('task = "dynamics"\n[fixed]\nsystem = "henon"\n[grid]\nparams_Q = [1.0]', "Q=1.0"),
        (
            'task = "escape"\n[fixed]\nsystem = "duffing"\ninto = "position>1.5,z<1"\n'
            "[grid]\nnoise = [0.5]",
            "'z'",
        ),
        ('task = "groups"\n[fixed]\nmap = "broken.json"\n[grid]\nbounce = [45]', "broken.json"),
    ],
    ids=["results", "params", "into", "map"],
)
def test_mistakes_that_all_members_share_are_refused(text, message, tmp_path):
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "spec.toml").write_text(text)
    with pytest.raises(ValueError, match=f"spec.toml: .*{message}"):
        run_sweep(Spec.load(tmp_path / "spec.toml"), tmp_path / "out")


def test_number_without_a_zero_is_explained(spec_file):
    with pytest.raises(ValueError, match=r"Invalid value .*; write 0\.5 for \.5"):
        Spec.load(spec_file("[grid]\nx = [1.0, .5]"))
