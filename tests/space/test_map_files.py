import dataclasses
import json
import math
import re
import stat

import numpy as np
import pytest
from hypothesis import given, strategies as st
from mutations import place

from jaxcell.space import Workspace
from jaxcell.space.maps.map_files import format_json, parse_json


ROOM = {"format": "jaxcell-map", "version": 1, "boundary": [[0, 0], [6, 0], [6, 5], [0, 5]]}
BOX = [[1, 1], [2, 1], [2, 2], [1, 2]]


def fields_of(room):
    return {field.name: getattr(room, field.name) for field in dataclasses.fields(room)}


def assert_same(a, b):
    np.testing.assert_equal(fields_of(a), fields_of(b))


coordinates = st.floats(-1e3, 1e3, allow_nan=False)
lengths = st.floats(1e-3, 1e3)


@given(
    corner=st.tuples(coordinates, coordinates),
    width=lengths,
    height=lengths,
    dents=st.lists(st.floats(0.01, 0.99), max_size=3),
    name=st.text().filter(str.isprintable),
    cell=st.none() | lengths,
    directions=st.none() | st.integers(1, 2**40),
)
def test_json_round_trip_is_exact(corner, width, height, dents, name, cell, directions):
    x, y = corner
    room = Workspace(
        [(x, y), (x + width, y + height / 3), (x + width, y + height), (x, y + height)],
        [[(x, y), (x + d * width, y + height), (x, y + height)] for d in dents],
        robot_radius=min(width, height) / 1000,
        name=name,
        cell=cell,
        directions=directions,
    )
    assert_same(Workspace(**parse_json(format_json(fields_of(room)))), room)


def test_saved_files_are_read_back(tmp_path):
    room = Workspace(ROOM["boundary"], [BOX], 0.1, 'Café "1"', 0.25, 16)
    room.save(tmp_path / "room.json")
    assert_same(Workspace.load(tmp_path / "room.json"), room)
    assert_same(Workspace.load(str(tmp_path / "room.json")), room)
    document = json.loads((tmp_path / "room.json").read_text(encoding="utf-8"))
    assert document["units"] == "m"
    names = "format version units name boundary obstacles robot_radius cell directions"
    assert list(document) == names.split()


def test_a_map_without_a_name_takes_the_name_of_its_file(tmp_path):
    (tmp_path / "hall.json").write_text(json.dumps(ROOM))
    hall = Workspace.load(tmp_path / "hall.json")
    assert_same(hall, Workspace(ROOM["boundary"], name="hall"))


def test_a_byte_order_mark_is_ignored(tmp_path):
    (tmp_path / "hall.JSON").write_text(json.dumps(ROOM), encoding="utf-8-sig")
    assert Workspace.load(tmp_path / "hall.JSON").free_space.area == 30


@pytest.mark.parametrize(("units", "metre"), [("m", 1), ("cm", 100), ("mm", 1000)])
def test_lengths_are_converted_to_metres(units, metre):
    numbers = {"robot_radius": 0.17, "cell": 0.25}
    scaled = {key: value * metre for key, value in numbers.items()}
    boundary = [[x * metre, y * metre] for x, y in [(0, 0), (0.57, 0), (0.57, 0.29), (0, 0.29)]]
    obstacles = [[[0, 0], [0, metre], [metre, 0]]]
    fields = parse_json(
        json.dumps(ROOM | {"units": units, "boundary": boundary, "obstacles": obstacles, **scaled})
    )
    assert fields["boundary"] == [[0, 0], [0.57, 0], [0.57, 0.29], [0, 0.29]]
    assert fields["obstacles"] == [[[0, 0], [0, 1], [1, 0]]]
    assert {key: fields[key] for key in numbers} == numbers
    feet = parse_json(json.dumps(ROOM | {"units": "ft", "cell": 0.5}))
    assert (feet["boundary"][2], feet["cell"]) == ([1.8288, 1.524], 0.1524)


FIELDS = [
    ({"format": "other"}, "format: expected"),
    ({"format": None}, "format: expected"),
    ({"version": 2}, "version: expected 1, got 2"),
    ({"version": True}, "version: expected 1, got True"),
    ({"version": "1"}, "version: expected 1, got '1'"),
    ({"robot_radis": 0.1}, "'robot_radis': unknown key; expected boundary, obstacles"),
    ({"units": "inch"}, "units: expected m, cm, mm, ft, got 'inch'"),
    ({"units": ["m"]}, "units: expected m, cm, mm, ft, got ['m']"),
    ({"boundary": 3}, "boundary: expected a list, got 3"),
    ({"boundary": [[0, 0], [1, 0], [1]]}, "boundary[2]: expected a pair [x, y], got [1]"),
    ({"boundary": [[0, 0], [1, 0], "1 1"]}, "boundary[2]: expected a pair [x, y], got '1 1'"),
    ({"boundary": [[0, 0], [1, "0"], [1, 1]]}, "boundary[1]: expected a finite number, got '0'"),
    ({"boundary": [[0, 0], [1, True], [1, 1]]}, "boundary[1]: expected a finite number, got True"),
    ({"boundary": [[0, 0], [1, 10**400], [1, 1]]}, "boundary[1]: expected a finite number, got"),
    ({"boundary": [[0, 0], [1, math.nan], [1, 1]]}, "boundary[1]: expected a finite number, got"),
    ({"obstacles": BOX}, "obstacles[0][0]: expected a pair [x, y], got 1"),
    ({"obstacles": {}}, "obstacles: expected a list, got {}"),
    ({"obstacles": [BOX, None]}, "obstacles[1]: expected a list, got None"),
    ({"robot_radius": "big"}, "robot_radius: expected a finite number, got 'big'"),
    ({"cell": None}, "cell: expected a finite number, got None"),
    ({"directions": 8.0}, "directions: expected a whole number, got 8.0"),
    ({"name": 3}, "name: expected text, got 3"),
]
CONTENTS = [
    (b"", "not valid JSON, or cut short"),
    (b"[]", "format: expected"),
    (b"3", "format: expected"),
    (b"null", "format: expected"),
    (b'{"format": "jaxcell-map", "version": 1}', "boundary: it is missing"),
    (b'{"nodes": []}', "it is a graph, not a map; study.PatrolGraph and load_graph take it"),
    (b'{"cell": 1, "cell": 2}', "not valid JSON, or cut short: the key 'cell' is repeated"),
    (b"[" * 100_000, "not a map: its brackets are nested too deeply"),
    (b'{"cell": ' + b"9" * 5000 + b"}", "not valid JSON, or cut short"),
    ('{"name": "Café"}'.encode("latin-1"), "expected UTF-8 text; byte 13 is not"),
    (json.dumps(ROOM).encode("utf-16"), "expected UTF-8 text; byte 0 is not"),
    (b"\x89PNG\r\n", "expected UTF-8 text; byte 0 is not"),
]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        *(("map.json", json.dumps(ROOM | change).encode(), message) for change, message in FIELDS),
        *(("map.json", content, message) for content, message in CONTENTS),
        ("map.svg", b"", "unknown format '.svg'; expected .json or .geojson (polygons), .yaml"),
        ("map", b"", "unknown format ''"),
        ("map.pgm", b"", "an image alone has no scale"),
        ("map.PNG", b"", "an image alone has no scale"),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, message):
    path = place(tmp_path, name, content)
    with pytest.raises(ValueError, match="^" + re.escape(f"{path}: {message}")):
        Workspace.load(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.json: there is no such file"):
        Workspace.load(tmp_path / "none.json")
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(ValueError, match=r"folder\.json: expected a map file, got a directory"):
        Workspace.load(tmp_path / "folder.json")


def test_saving_in_an_unknown_format_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"map\.svg: unknown format '\.svg'"):
        Workspace(ROOM["boundary"]).save(tmp_path / "map.svg")
    assert list(tmp_path.iterdir()) == []


def test_saved_files_have_the_usual_permissions(tmp_path):
    Workspace(ROOM["boundary"]).save(tmp_path / "map.json")
    (tmp_path / "plain").touch()
    modes = [stat.S_IMODE((tmp_path / n).stat().st_mode) for n in ("map.json", "plain")]
    assert modes[0] == modes[1]
