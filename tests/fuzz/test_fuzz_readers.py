"""Damaged files of every reader: each file is read, or refused in a line that names it."""

import dataclasses
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import shapefile
import shapely
from hypothesis import given, strategies as st
from mutations import DATA, cases, changed_json, damaged, limits, place, reads_or_refuses
from PIL import Image

from jaxcell.currents.land import read_land
from jaxcell.patrol import load_graph
from jaxcell.patrol.files import load_ways
from jaxcell.patrol.rounds import load_game, load_routes
from jaxcell.robot.run_log import read_log
from jaxcell.robot.tasks.files import load_task
from jaxcell.space import CellSpace, Workspace
from jaxcell.study.bounce.target import read_target


CELLS = CellSpace.load(DATA / "maps/lab_a.json")


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader, the good files to damage, of any bytes or JSON, and files that it also opens."""

    read: Callable
    files: Mapping = dataclasses.field(default_factory=dict)
    documents: Mapping = dataclasses.field(default_factory=dict)
    beside: Mapping = dataclasses.field(default_factory=dict)

    def every_file(self):
        """The bytes of all good files."""
        return {**self.files, **{name: encoded(text) for name, text in self.documents.items()}}


def encoded(document):
    return json.dumps(document).encode()


def bundled(name):
    return json.loads((DATA / name).read_text())


def picture(form, mode="L"):
    pixels = np.full((5, 7), 254, np.uint8)
    pixels[1:3, 2] = 0
    file = io.BytesIO()
    Image.fromarray(pixels).convert(mode).save(file, form)
    return file.getvalue()


PLAIN_GRAPH = {
    "directed": False,
    "multigraph": False,
    "graph": {},
    "nodes": [{"id": i, "x": i * 1.5, "y": -i} for i in range(4)],
    "edges": [{"source": i, "target": i + 1} for i in range(3)],
}
LINKS = {
    "nodes": [{"id": name, "pos": [0, i]} for i, name in enumerate("abc")],
    "links": [{"source": "a", "target": "b"}, {"source": "b", "target": "c"}],
}


def graphml():
    graph = nx.path_graph(3)
    for v in graph:
        graph.nodes[v].update(x=1.0 * v, y=2 * v, name="hall", lit=True)
    graph.edges[0, 1]["weight"] = 2.5
    return "\n".join(nx.generate_graphml(graph)).encode()


ISLAND = shapely.geometry.mapping(shapely.box(-120, 33, -119, 34))
FEATURE = {"type": "Feature", "properties": {"name": "island"}, "geometry": ISLAND}


def shapefile_bytes():
    shp, shx, dbf = io.BytesIO(), io.BytesIO(), io.BytesIO()
    with shapefile.Writer(shp=shp, shx=shx, dbf=dbf, shapeType=shapefile.POLYGON) as writer:
        writer.field("name")
        writer.poly([list(map(list, ISLAND["coordinates"][0]))])
        writer.record("island")
    return shp.getvalue()


YAML = (
    b"image: m.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
)
MAP_PICTURES = {
    "m.pgm": picture("PPM"),
    "plain.pgm": b"P2\n# by hand\n3 2\n255\n255 0 255\n254 254 254\n",
    "m.png": picture("PNG"),
    "rgba.png": picture("PNG", "RGBA"),
    "palette.png": picture("PNG", "P"),
    "two.png": picture("PNG", "1"),
    "m.bmp": picture("BMP"),
}
COMMON = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.1}
TASKS = {
    "plan.json": {
        **{"command": "jaxcell navigate", "found": True, "start": 0, **COMMON},
        "actions_deg": [0.0, 0.0, 90.0, 0],
    },
    "team.json": {
        **{"format": "jaxcell-robot-task", "kind": "team", **COMMON},
        "robots": [
            {"start": [0.5, 0.5, 90.0], "bounce_deg": 135.0, "actions": "0012+-"},
            {"start": [1.5, 0.5, 0], "bounce_deg": 45, "actions": ""},
        ],
    },
    "patrol.json": {
        **{"format": "jaxcell-robot-task", "kind": "patrol", **COMMON},
        "range_m": 2.0,
        "origin_m": [0.0, 0.0],
        "free": ["..", ".#"],
        "closed": [[0, 0], [1, 2]],
        "robots": [{"start": 0, "image": [[2, 0, 0]], "probability": [[1.0, 1.0, 1.0]]}],
    },
}
LOG = [
    {"format": "jaxcell-robot-log", "version": 1, "kind": "filter", "file": "f.jxf", "cell_m": 1},
    {"event": "start", "seconds": 0.1},
    {"event": "observation", "seconds": 0.2, "observation": 1, "color": 1, "estimate": [0.1, 0, 0]},
    {"event": "observation", "seconds": 0.3, "observation": 0, "color": 2, "estimate": [0, 0, 1.5]},
    {"event": "end", "seconds": 0.4, "result": "localized", "reason": "x"},
]


def use_task(path):
    """Reads a task, and makes the header of its log."""
    task = load_task(path)
    assert len(task.strides) == task.directions
    json.dumps(task.header, allow_nan=False)


def use_log(path):
    run = read_log(path)
    assert set(run.observations) <= {"0", "1"}
    assert isinstance(run.colors, list)


GAMES = Path(__file__).parents[1] / "study" / "games"
ROUTES = {
    "features": [
        {"properties": {"id": 0}, "geometry": {"type": "Point", "coordinates": [0.0, 0.0]}},
        {"properties": {"id": 1}, "geometry": {"type": "Point", "coordinates": [3.0, 4.0]}},
        {"properties": {"id": 2, "startid": 0, "endid": 1, "cost": 2.0}, "geometry": {}},
    ]
}
READERS = {
    "graph": Reader(
        load_graph,
        {
            "g.graphml": graphml(),
            "g.edges": b"# Three\nhall 0 0\nyard 3.5 1\n\nroom 1e3 -2 # far\nhall yard\n",
            "g.txt": b"a 0 0\nb 0 1\na b\n",
        },
        {"g.json": PLAIN_GRAPH, "l.json": LINKS, "tree.json": bundled("graphs/tree.json")},
    ),
    "ways": Reader(
        load_ways,
        {"g.graphml": graphml()},
        {
            **{"g.json": PLAIN_GRAPH, "l.json": LINKS, "routes.geojson": ROUTES},
            "problem.json": {"problem_params": {"weight_matrix": [[1, 3], [2, 1]], "tau": 4}},
        },
    ),
    "game": Reader(
        load_game, documents={"game.json": json.loads((GAMES / "game.json").read_text())}
    ),
    "routes": Reader(
        lambda path: load_routes(path, load_game(GAMES / "game.json")),
        documents={"patrol.json": json.loads((GAMES / "patrol.json").read_text())},
    ),
    "land": Reader(
        read_land,
        {"land.shp": shapefile_bytes()},
        {"land.geojson": {"type": "FeatureCollection", "features": [FEATURE, FEATURE]}},
    ),
    "map": Reader(
        Workspace.load,
        {
            "n.json": b'{"format": "jaxcell-map", "version": 1, "units": "ft", "boundary": '
            b'[[0, 0], [6, 0], [0, 5]], "robot_radius": 0.17, "cell": 0.25, "directions": 16}',
            "m.txt": b"; name a corridor\n; cell 0.25\n; origin 1 2\n; robot_radius 0.1\n"
            b"; directions 8\n;; a remark\n#######\n#..#..#\n#.....#\n#######\n",
            "n.map": b"...\n.#.\n...\n",
            "ai.map": b"type octile\nheight 2\nwidth 4\nmap\n@.GT\nWS.O\n",
        },
        {
            **{name: bundled(f"maps/{name}") for name in ("arena.json", "lab_a.json")},
            "complex.json": bundled("maps/complex.json"),
            "plan.geojson": {"type": "FeatureCollection", "features": [FEATURE]},
            "house.json": {"verts": [[0, 0], [5, 0], [5, 4], [0, 4]], "id": "0a1"},
        },
    ),
    "description of a map": Reader(Workspace.load, {"m.yaml": YAML}, beside=MAP_PICTURES),
    "picture of a map": Reader(
        lambda path: Workspace.load(f"{path}.yaml"),
        MAP_PICTURES,
        beside={f"{name}.yaml": YAML.replace(b"m.pgm", name.encode()) for name in MAP_PICTURES},
    ),
    "picture to cover": Reader(
        lambda path: read_target(CELLS, str(path)),
        {
            **{"a.png": picture("PNG"), "a.pgm": picture("PPM"), "a.tif": picture("TIFF", "F")},
            **{"a.gif": picture("GIF"), "a.jpg": picture("JPEG"), "a.bmp": picture("BMP", "RGB")},
        },
    ),
    "task of a robot": Reader(use_task, documents=TASKS),
    "log of a robot": Reader(use_log, {"run.jsonl": b"\n".join(encoded(event) for event in LOG)}),
}


@pytest.fixture(params=READERS, scope="module")
def reader(request):
    return READERS[request.param]


@pytest.fixture
def folder(tmp_path, reader):
    """A folder with the files that the reader opens beside the damaged one."""
    for name, content in reader.beside.items():
        place(tmp_path, name, content)
    return tmp_path


def test_good_files_are_read(folder, reader):
    for name, content in reader.every_file().items():
        assert reads_or_refuses(reader.read, place(folder, name, content))


@cases()
@given(data=st.data())
def test_damaged_files_are_read_or_refused(folder, reader, data):
    reads_or_refuses(reader.read, place(folder, *data.draw(damaged(reader.every_file()))))


@pytest.mark.parametrize("name", [name for name in READERS if READERS[name].documents])
@cases()
@given(data=st.data())
def test_changed_documents_are_read_or_refused(tmp_path, name, data):
    reader = READERS[name]
    reads_or_refuses(reader.read, place(tmp_path, *data.draw(changed_json(reader.documents))))


@cases()
@given(changed_json({str(i): event for i, event in enumerate(LOG)}))
def test_logs_with_a_changed_event_are_read_or_refused(tmp_path, event):
    lines = [encoded(event) for event in LOG]
    lines[int(event[0])] = event[1]
    reads_or_refuses(use_log, place(tmp_path, "run.jsonl", b"\n".join(lines) + b"\n"))


def plan(**fields):
    return encoded(TASKS["plan.json"] | fields)


def log(number, text):
    return b"\n".join([*map(encoded, LOG[:number]), text, *map(encoded, LOG[number + 1 :])])


def growing_yaml(field):
    """A description in which a field is a list of 9^12 words."""
    text = "l0: &l0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
        f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]\n" for i in range(1, 12)
    )
    start = YAML.index(field)
    line = YAML[start : YAML.index(b"\n", start)]
    return text.encode() + YAML.replace(line, field + b": *l11")


ENTITIES = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
WRAPPED = TASKS["patrol.json"]["robots"][0] | {"image": [[2**32 + 2, 2**32, 0]]}
HARD = [
    ("graph", "g.graphml", graphml().replace(b"xmlns:xsi", b":xsi"), None),
    (
        "graph",
        "g.graphml",
        f'<?xml version="1.0"?><!DOCTYPE graphml [<!ENTITY l0 "ha">{ENTITIES}]>'
        '<graphml><graph edgedefault="undirected"><node id="&l11;"/></graph></graphml>'.encode(),
        None,
    ),
    *(
        ("description of a map", "m.yaml", growing_yaml(field), None)
        for field in (b"origin", b"image", b"negate", b"resolution", b"mode", b"free_thresh")
    ),
    *(
        ("picture of a map", "m.pgm", f"P5\n{size}\n255\n".encode() + b"\0" * 50, message)
        for size, message in (
            ("1000000000 1000000000", "too large: 1,000,000,000 x 1,000,000,000 pixels"),
            ("30000 30000", "too large: 30,000 x 30,000 pixels"),
            ("9000 9000", "broken or cut short"),
            ("0 5", "image: m.pgm: "),
            ("-1 5", "image: m.pgm: "),
        )
    ),
    *(
        ("map", name, content, None)
        for name in ("a.json", "a.txt", "a.map", "a.yaml", "a.yml", "a.pgm", "a.png")
        for content in (b"", b"\n", b"; cell 1", b"#", b"{}", b"[]", b"null", b"0", b"\xef\xbb\xbf")
    ),
    ("picture to cover", "a.pgm", b"P5 300000 300000 255\n" + bytes(100), None),
    ("task of a robot", "plan.json", plan(cell_m=10**400), None),
    ("task of a robot", "plan.json", plan(cell_m=0), None),
    ("task of a robot", "plan.json", plan(directions=10**12), None),
    ("task of a robot", "plan.json", b"[" * 100_000, None),
    # 2^32 is 0 in 32 bits, which is a position.
    (
        "task of a robot",
        "patrol.json",
        encoded(TASKS["patrol.json"] | {"robots": [WRAPPED]}),
        r"robots\[0\]\.image: expected finite numbers of at most",
    ),
    ("log of a robot", "run.jsonl", log(2, b'{"event": "observation", "observation": true}'), None),
    ("log of a robot", "run.jsonl", log(2, b'{"event": "observation", "observation": 1.0}'), None),
    ("log of a robot", "run.jsonl", log(0, b"[" * 100_000), None),
]


@pytest.mark.parametrize(
    ("reader", "file", "content", "message"),
    [(READERS[name], *hard) for name, *hard in HARD],
    ids=range(len(HARD)),
)
def test_hard_files_are_refused(folder, reader, file, content, message):
    path = place(folder, file, content)
    assert not reads_or_refuses(reader.read, path)
    with limits(), pytest.raises((ValueError, OSError), match=message):
        reader.read(path)


def test_too_large_files_are_refused(tmp_path):
    path = place(tmp_path, "g.edges", b"")
    with path.open("r+b") as file:
        file.truncate(64 * 2**20 + 1)
    assert not reads_or_refuses(load_graph, path, "67,108,865 bytes")
