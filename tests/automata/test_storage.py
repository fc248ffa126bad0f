import hashlib
import json
import os
import struct

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import Filter, storage, subset_construction


FIELDS = ("transition", "uncertainty", "offsets", "members", "color")


@pytest.fixture(scope="module")
def saved(labs, tmp_path_factory):
    """A filter, the file it is in, and a second path in the same folder."""
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


@given(data=st.data(), open_world=st.booleans(), piece=st.sampled_from([1, 3, 1 << 20]))
def test_what_is_loaded_is_what_was_saved(saved, graphs, data, open_world, piece):
    _, _, path = saved
    metadata = data.draw(st.dictionaries(st.text(), st.none() | st.floats(-1, 1) | st.text()))
    automaton = subset_construction(*data.draw(graphs))
    filter = Filter.of(automaton, open_world=open_world, metadata=metadata)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "_PIECE", piece)
        filter.save(path)
        assert_same(Filter.load(path), filter)


@pytest.mark.parametrize("piece", [1000, 1 << 20])
def test_large_arrays(tmp_path, monkeypatch, piece):
    monkeypatch.setattr(storage, "_PIECE", piece)
    rng = np.random.default_rng(0)
    arrays = {
        "noise": rng.integers(-(2**31), 2**31, 300_000).astype(np.int32),
        "empty": np.zeros(0, np.int32),
        "still": np.full(2_000_000, 7, np.int32),
        "ends": np.array([-(2**31), 2**31 - 1] * 5000, np.int32),
    }
    storage.write_arrays(tmp_path / "x", {"a": 1}, arrays)
    header, loaded = storage.read_arrays(tmp_path / "x")
    assert header == {"a": 1}
    assert loaded.keys() == arrays.keys()
    for name in arrays:
        np.testing.assert_array_equal(loaded[name], arrays[name])


def test_equal_filters_give_equal_bytes(saved):
    filter, path, other = saved
    filter.save(other)
    assert other.read_bytes() == path.read_bytes()


@given(data=st.data())
def test_an_altered_byte_is_refused(saved, data):
    _, path, other = saved
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    other.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.filter: (not a jaxcell file|truncated or)"):
        Filter.load(other)


@given(data=st.data())
def test_a_truncated_file_is_refused(saved, data):
    _, path, other = saved
    content = path.read_bytes()
    other.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    with pytest.raises(ValueError, match=r"other\.filter: (not a jaxcell file|truncated)"):
        Filter.load(other)


def test_a_file_with_more_at_its_end_is_refused(saved):
    _, path, other = saved
    other.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(ValueError, match="truncated or altered"):
        Filter.load(other)


def forge(path, *, version=1, text=None, header=None, arrays=None, payload=b"", size=None):
    """Writes a file whose checksum is right, whatever else is wrong with it."""
    if text is None:
        text = json.dumps({"header": header, "arrays": arrays}).encode()
    size = len(payload) if size is None else size
    body = b"jaxcell\0" + struct.pack("<II", version, len(text)) + text
    body += struct.pack("<Q", size) + payload
    path.write_bytes(body + hashlib.sha256(body).digest())


@pytest.mark.parametrize(
    ("forged", "message"),
    [
        ({"version": 2}, "format version 2; this program reads 1"),
        ({"size": 10**18}, "its lengths do not agree"),
        ({"text": b"{"}, "its header cannot be read"),
        ({"text": b"[" * 100_000}, "its header cannot be read"),
        ({"text": b"[]"}, "its header cannot be read"),
        ({"header": {}, "arrays": {"a": "x"}}, "its header cannot be read"),
        ({"header": {}, "arrays": {"a": 10**15}}, "cannot come from its payload"),
        ({"header": {}, "arrays": {"a": -1}}, "cannot come from its payload"),
        ({"header": {}, "arrays": {"a": 1}, "payload": b"????"}, "its payload cannot be read"),
        ({"header": {}, "arrays": {}, "payload": b""}, "its payload cannot be read"),
    ],
)
def test_a_forged_file_is_refused(tmp_path, forged, message):
    forge(tmp_path / "x", **forged)
    with pytest.raises(ValueError, match=f"x: .*{message}"):
        storage.read_arrays(tmp_path / "x")


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"a": 9}, "it ends early"), ({"a": 2}, "it goes on past its arrays")],
)
def test_a_payload_of_another_size_is_refused(tmp_path, changes, message):
    path = tmp_path / "x"
    storage.write_arrays(path, {}, {"a": np.arange(5, dtype=np.int32)})
    content = path.read_bytes()
    begin = content.index(b"x\x01") - 8
    forge(path, header={}, arrays=changes, payload=content[begin + 8 : -32])
    with pytest.raises(ValueError, match=message):
        storage.read_arrays(path)


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
        ({}, {"uncertainty": np.zeros(3, np.int32)}, "tables are of different lengths"),
        ({}, {"members": np.zeros(3, np.int32)}, "expected to rise from 0 to the 3 members"),
        ({}, {"transition": np.zeros(260, np.int32)}, "breadth-first order|a trap"),
    ],
)
def test_a_file_of_something_else_is_refused(saved, header, change, message):
    filter, _, other = saved
    header = {"kind": "filter", "open_world": True, "metadata": {}} | header
    storage.write_arrays(other, header, arrays_of(filter) | change)
    with pytest.raises(ValueError, match=rf"other\.filter: .*({message})"):
        Filter.load(other)


@pytest.mark.parametrize("missing", ["kind", "open_world", "metadata"])
def test_a_missing_field_is_named(saved, missing):
    filter, _, other = saved
    header = {"kind": "filter", "open_world": True, "metadata": {}}
    del header[missing]
    storage.write_arrays(other, header, arrays_of(filter))
    with pytest.raises(ValueError, match=rf"other\.filter: '{missing}' is missing"):
        Filter.load(other)


def test_a_failed_save_leaves_the_old_file(saved, tmp_path, monkeypatch):
    filter, _, _ = saved
    target = tmp_path / "kept.filter"
    target.write_bytes(b"old")

    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="no space"):
        filter.save(target)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["kept.filter"]


def test_a_save_replaces_the_old_file(saved, tmp_path):
    filter, path, _ = saved
    target = tmp_path / "kept.filter"
    target.write_bytes(b"old")
    filter.save(target)
    assert target.read_bytes() == path.read_bytes()
    assert os.listdir(tmp_path) == ["kept.filter"]
