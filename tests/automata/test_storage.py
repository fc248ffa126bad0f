import io
import zipfile

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import Filter, subset_construction
from jaxcell.automata.formats import storage


FIELDS = ("transition", "uncertainty", "offsets", "members", "color")


@pytest.fixture(scope="module")
def saved(labs, tmp_path_factory):
    """A filter, its file, and a second path in the same folder."""
    automaton = subset_construction(*labs["a", 45])
    filter = Filter.of(automaton, open_world=True, metadata={"map": "lab a", "bounce_deg": 45})
    path = tmp_path_factory.mktemp("filters") / "lab.filter"
    filter.save(path)
    return filter, path, path.with_name("other.filter")


def assert_same(a, b):
    for field in FIELDS:
        x, y = getattr(a, field), getattr(b, field)
        np.testing.assert_array_equal(x, y)
        assert x.dtype == y.dtype
    assert (a.open_world, a.metadata) == (b.open_world, b.metadata)


@given(data=st.data(), open_world=st.booleans())
def test_filter_is_read_back(saved, graphs, data, open_world):
    _, _, path = saved
    metadata = data.draw(st.dictionaries(st.text(), st.none() | st.floats(-1, 1) | st.text()))
    automaton = subset_construction(*data.draw(graphs))
    filter = Filter.of(automaton, open_world=open_world, metadata=metadata)
    filter.save(path)
    assert_same(Filter.load(path), filter)


def test_large_arrays_are_read_back(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "noise": rng.integers(-(2**31), 2**31, 300_000).astype(np.int32),
        "empty": np.zeros(0, np.int32),
        "still": np.full(2_000_000, 7, np.int32),
        "ends": np.array([-(2**31), 2**31 - 1] * 5000, np.int32),
    }
    storage.write_arrays(tmp_path / "x", {"a": 1}, arrays)
    header, loaded = storage.read_arrays(tmp_path / "x")
    assert header == {"a": 1, "version": 1}
    assert loaded.keys() == arrays.keys()
    for name in arrays:
        np.testing.assert_array_equal(loaded[name], arrays[name])
        assert loaded[name].dtype == np.int32


def test_equal_filters_give_equal_bytes(saved):
    filter, path, other = saved
    filter.save(other)
    assert other.read_bytes() == path.read_bytes()


@given(st.data(), st.booleans())
def test_files_with_an_altered_byte_or_cut_at_it_are_refused_or_unchanged(saved, data, cut):
    """Some bytes of a zip file have no effect."""
    filter, path, other = saved
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    other.write_bytes(content[:place] if cut else content)
    try:
        found = Filter.load(other)
    except ValueError as error:
        assert f"other.filter: {'not a jaxcell file, truncated or altered' * cut}" in str(error)
    else:
        assert not cut
        assert_same(found, filter)


def forge(path, **members):
    """Write a file of any content with correct checksums."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            if content is not None:
                file.writestr(f"{name}.npy", content)


def npy(array):
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return file.getvalue()


def header(text):
    return npy(np.frombuffer(text, np.uint8))


WHOLE = {"header": header(b"{}"), "a": npy(np.arange(3, dtype=np.int32))}


@pytest.mark.parametrize(
    ("forged", "message"),
    [
        ({"header": None}, "not a jaxcell file"),
        ({"header": header(b"{")}, "not a jaxcell file"),
        ({"header": header(b"[" * 100_000)}, "not a jaxcell file"),
        ({"header": header(b"[]")}, "its header: expected a JSON object"),
        ({"header": b"x"}, "not a jaxcell file"),
        ({"header": npy([1.5])}, "not a jaxcell file"),
        ({"a": npy(["x"])}, "a: expected a list of 32-bit numbers"),
        ({"a": npy(np.zeros((2, 2), np.int32))}, "a: expected a list of 32-bit numbers"),
        ({"a": npy(np.arange(3, dtype=np.int32)).replace(b"(3,)", b"(9,)")}, "not a jaxcell file"),
        ({"a": npy(np.zeros(3, np.int32)).replace(b"(3,), }", b"(10**15,)}")}, "not a jaxcell"),
        (
            {"a": npy(np.zeros(3, np.int32)).replace(b"(3,), }" + b" " * 20, b"(%d,), }" % 10**20)},
            "not a jaxcell file",
        ),
    ],
)
def test_forged_files_are_refused(tmp_path, forged, message):
    forge(tmp_path / "x", **WHOLE)
    assert storage.read_arrays(tmp_path / "x")[1]["a"].tolist() == [0, 1, 3]
    forge(tmp_path / "x", **WHOLE | forged)
    with pytest.raises(ValueError, match=f"x: .*{message}"):
        storage.read_arrays(tmp_path / "x")


def test_files_of_earlier_versions_are_refused_with_the_reason(tmp_path):
    (tmp_path / "x").write_bytes(b"jaxcell\0\1\0\0\0 and more")
    with pytest.raises(
        ValueError, match=r"x: it is of an earlier version .* make the filter again"
    ):
        storage.read_arrays(tmp_path / "x")


def arrays_of(filter):
    return {
        "transition": filter.transition.ravel(),
        "uncertainty": filter.uncertainty,
        "sizes": np.diff(filter.offsets).astype(np.int32),
        "members": filter.members,
    }


@pytest.mark.parametrize(
    ("header", "change", "message"),
    [
        ({"kind": "plan"}, {}, "it is a plan, not a filter"),
        ({"kind": None}, {}, "it is a None, not a filter"),
        ({"kind": ...}, {}, "'kind' is missing"),
        ({"open_world": ...}, {}, "'open_world' is missing"),
        ({"metadata": ...}, {}, "'metadata' is missing"),
        ({}, {"uncertainty": np.zeros(3, np.int32)}, "tables are of different lengths"),
        ({}, {"members": np.zeros(3, np.int32)}, "expected to rise from 0 to the 3 members"),
        ({}, {"transition": np.zeros(260, np.int32)}, "breadth-first order|a trap"),
    ],
)
def test_inconsistent_filter_files_are_refused(saved, header, change, message):
    filter, _, other = saved
    header = {"kind": "filter", "open_world": True, "metadata": {}} | header
    header = {name: value for name, value in header.items() if value is not ...}
    storage.write_arrays(other, header, arrays_of(filter) | change)
    with pytest.raises(ValueError, match=rf"other\.filter: .*({message})"):
        Filter.load(other)


def test_a_file_that_decompresses_to_too_much_is_refused_unread(tmp_path, monkeypatch):
    storage.write_arrays(tmp_path / "x", {}, {"zeros": np.zeros(100_000, np.int32)})
    assert (tmp_path / "x").stat().st_size < 2000
    monkeypatch.setattr(storage, "LARGEST", 300_000)
    monkeypatch.setattr(np.lib.format, "read_array", None)
    with pytest.raises(ValueError, match=r"x: it decompresses to 400,\d+ bytes, more"):
        storage.read_arrays(tmp_path / "x")
    monkeypatch.setattr(storage, "LARGEST_HEADER", 100)
    with pytest.raises(ValueError, match=r"its header has .* bytes, more than 100"):
        storage.read_arrays(tmp_path / "x")
