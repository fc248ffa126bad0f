"""Maps as other programs save them: each file is written here, and read by hand or by shapely."""

import dataclasses
import json

import numpy as np
import pytest
import shapely
from PIL import Image

from jaxcell.base.doubts import Doubt
from jaxcell.cli import main
from jaxcell.space import CellSpace, Workspace


# A room of 6 x 4 pixels with walls around it, and a closet of one pixel in the wall.
ROOM = np.zeros((6, 9), np.uint8)
ROOM[1:5, 1:7] = 254
ROOM[2, 8] = 254
YAML = "image: {image}\nresolution: 0.5\norigin: {origin}\nnegate: 0\noccupied_thresh: 0.65\n"


def save(folder, pixels=ROOM, name="map.png", origin="[0, 0, 0]", image=None, mode=""):
    Image.fromarray(pixels).save(folder / name)
    text = YAML.format(image=image or name, origin=origin) + "free_thresh: 0.196\n"
    (folder / "map.yaml").write_text(text + (f"mode: {mode}\n" if mode else ""))
    return folder / "map.yaml"


def free_of(room, side=0.5):
    """The mask of free squares, row 0 at the top, asked of the middle of each square."""
    low, high = room.boundary.min(axis=0), room.boundary.max(axis=0)
    columns, rows = np.rint((high - low) / side).astype(int)
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    return shapely.contains_xy(room.free_space, low[0] + side * x, low[1] + side * y)[::-1]


@pytest.mark.parametrize("name", ["map.pgm", "map.png", "map.bmp"])
def test_pictures_of_each_format_are_read_in_every_pixel(tmp_path, name):
    room = dataclasses.replace(Workspace.load(save(tmp_path, name=name)), piece="all")
    np.testing.assert_array_equal(free_of(room), ROOM > 0)


@pytest.mark.parametrize("yaw", [0.3, -2.0, 1.5707963])
def test_a_turned_map_has_its_squares_where_the_map_server_puts_them(tmp_path, yaw):
    """The corner of the picture is the origin, and its rows go along the yaw."""
    path = save(tmp_path, origin=f"[-21.2, -14.9, {yaw}]")
    room = dataclasses.replace(Workspace.load(path), piece="all")
    along, up = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    row, column = np.indices(ROOM.shape)
    right, above = 0.5 * (column + 0.5), 0.5 * (len(ROOM) - row - 0.5)
    at = np.array([-21.2, -14.9]) + right[..., None] * along + above[..., None] * up
    np.testing.assert_array_equal(shapely.contains_xy(room.free_space, *at.T).T, ROOM > 0)
    assert room.free_space.area == pytest.approx(25 * 0.25)


def test_the_modes_scale_and_raw_are_those_of_nav2(tmp_path):
    # Occupancies of 0, 0.195, 0.2, 0.6 and 1, of which the first two are below free_thresh.
    shades = np.array([[255, 206, 204, 102, 0]], np.uint8)
    room = Workspace.load(save(tmp_path, shades, mode="scale"))
    np.testing.assert_array_equal(free_of(room), [[1, 1, 0, 0, 0]])
    # The value is the occupancy in percent, and unknown above 100.
    values = np.array([[0, 19, 20, 100, 101, 254, 255]], np.uint8)
    path = save(tmp_path, values, mode="raw")
    with pytest.warns(Doubt, match="map.png: 2 pixels of 101 to 254 are unknown, because the mode"):
        np.testing.assert_array_equal(free_of(Workspace.load(path)), [[1, 1, 0, 0, 0, 0, 0]])
    everything = Workspace.load(path, unknown="free")
    free = free_of(dataclasses.replace(everything, piece="all"))
    np.testing.assert_array_equal(free, [[1, 1, 1, 0, 1, 1, 1]])


@pytest.mark.parametrize("image", ["/home/robot/maps/map.png", "C:\\maps\\map.png"])
def test_the_image_beside_the_description_replaces_one_of_another_machine(tmp_path, image):
    with pytest.warns(UserWarning, match="there is no such file; .*map.png, beside the .yaml"):
        room = Workspace.load(save(tmp_path, image=image))
    assert room.name == "map"


def test_pictures_of_10000_by_10000_pixels_are_read(tmp_path):
    pixels = np.zeros((10_000, 10_000), np.uint8)
    pixels[10:20, 30:50] = 254
    room = Workspace.load(save(tmp_path, pixels, name="map.pgm"))
    assert room.free_space.bounds == (15, 4990, 25, 4995)


def test_the_main_piece_of_a_picture_is_used_and_said(tmp_path):
    room = Workspace.load(save(tmp_path))
    with pytest.warns(Doubt, match="map: the free space has 2 separate pieces: only the largest"):
        assert room.free_space.area == 24 * 0.25
    assert dataclasses.replace(room, piece=(4.2, 1.8)).free_space.area == 0.25
    with pytest.raises(ValueError, match=r"piece: no robot can be at 0,0; expected a point of the"):
        _ = dataclasses.replace(room, piece=(0.0, 0.0)).free_space
    half = np.where(np.arange(9) == 4, 0, 254)[None].astype(np.uint8)
    with pytest.warns(Doubt, match=r"all are used, the largest with 50 % of its area; for one"):
        assert Workspace.load(save(tmp_path, half)).free_space.area == 8 * 0.25
    # A polygon is as its author drew it.
    plain = Workspace(room.boundary, room.obstacles)
    assert plain.free_space.area == 25 * 0.25


def test_the_piece_travels_with_the_json_file_of_a_map(tmp_path):
    room = dataclasses.replace(Workspace.load(save(tmp_path)), piece=(4.25, 1.75))
    room.save(tmp_path / "map.json")
    again = Workspace.load(tmp_path / "map.json")
    assert (again.piece, again.free_space.area) == ((4.25, 1.75), 0.25)
    room = json.loads((tmp_path / "map.json").read_text())
    for wrong in ("biggest", [1], 3):
        (tmp_path / "map.json").write_text(json.dumps(room | {"piece": wrong}))
        with pytest.raises(ValueError, match=r"map.json: piece"):
            Workspace.load(tmp_path / "map.json")


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_part_of_a_map_is_read_as_its_squares(tmp_path, yaw):
    """The part between two corners is along the rows; squares that it meets are whole."""
    room = Workspace.load(save(tmp_path, origin=f"[2, 3, {yaw}]"))
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    # From the middle of the third pixel to that of the fifth, of the three lowest rows.
    corners = np.array([2, 3]) + np.array([[1.25, -0.2], [2.25, 1.5]]) @ turn.T
    part = Workspace.load(tmp_path / "map.yaml", crop=tuple(corners.ravel().tolist()))
    assert part.free_space.area == pytest.approx(3 * 2 * 0.25)
    assert shapely.difference(part.free_space, room.environment).area < 1e-9
    with pytest.raises(ValueError, match="`crop` is outside the map"):
        Workspace.load(tmp_path / "map.yaml", crop=(90.0, 90.0, 95.0, 95.0))
    part.save(tmp_path / "part.json")
    with pytest.raises(ValueError, match="`crop` has no effect; expected a map of squares"):
        Workspace.load(tmp_path / "part.json", crop=(0.0, 0.0, 1.0, 1.0))


def test_maps_of_moving_ai_are_read(tmp_path):
    path = tmp_path / "arena.map"
    path.write_text("type octile\nheight 3\nwidth 5\nmap\n@.GST\nO..WT\n@@@@@\n")
    free = CellSpace.load(path, directions=4).free[::-1]
    np.testing.assert_array_equal(free, [[0, 1, 1, 1, 0], [0, 1, 1, 0, 0], [0] * 5])
    for text, message in (
        ("height 2\nwidth 5\nmap\n....\n....\n", "width: expected 4 as in the rows below, got 5"),
        ("height 2\nwidth 4\nmap\n....\n...\n", "line 6: the row has 3 squares, but .* has 4"),
        ("height 1\nwidth 2\nmap\n.x\n", "line 5, column 2: expected one of '@OTW' .*, got 'x'"),
        ("height 1", "width: expected 0 as in the rows below, got None"),
    ):
        path.write_text(f"type octile\n{text}")
        with pytest.raises(ValueError, match=message):
            Workspace.load(path)


SQUARE = [[0, 0], [10, 0], [10, 8], [0, 8], [0, 0]]
HOLE = [[1, 1], [2, 1], [2, 2], [1, 1]]
DESK = [[4, 4, 7], [5, 4, 7], [5, 5, 7], [4, 4, 7]]


def features(*geometries):
    parts = [{"type": "Feature", "properties": {}, "geometry": part} for part in geometries]
    return {"type": "FeatureCollection", "features": parts}


def polygon(*rings):
    return {"type": "Polygon", "coordinates": list(rings)}


@pytest.mark.parametrize("suffix", [".geojson", ".json"])
def test_plans_of_polygons_are_read(tmp_path, suffix):
    path = tmp_path / f"plan{suffix}"
    door = {"type": "Point", "coordinates": [1, 1]}
    path.write_text(json.dumps(features(polygon(DESK), polygon(SQUARE, HOLE), door)))
    with pytest.warns(UserWarning, match="polygons") as doubts:
        room = Workspace.load(path)
    assert (room.free_space.area, len(room.obstacles)) == (79, 2)
    said = sorted(str(doubt.message) for doubt in doubts)
    assert said == [
        f"plan{suffix}: geometries that are no polygons, and are left out: 1",
        f"plan{suffix}: polygons within the largest, taken as obstacles: 1",
    ]


def test_plans_in_degrees_become_metres(tmp_path):
    """A degree of latitude has 111,195 m on a sphere of 6,371 km, one of longitude half at 60 N."""
    ring = np.array([4.0, 60.0]) + np.array(SQUARE) * 1e-4 * [2, 1]
    (tmp_path / "plan.json").write_text(json.dumps(polygon(ring.tolist())))
    with pytest.warns(Doubt, match="x and y are taken as degrees"):
        width, height = np.ptp(Workspace.load(tmp_path / "plan.json").boundary, axis=0)
    np.testing.assert_allclose([width, height], [111.195, 88.956], rtol=1e-4)


def test_plans_of_houseexpo_are_read(tmp_path):
    plan = {"id": "0a1", "room_num": 1, "verts": SQUARE[:-1], "bbox": {"min": [0, 0]}}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    room = Workspace.load(tmp_path / "plan.json")
    assert (room.free_space.area, room.name) == (80, "0a1")


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (features(), "expected GeoJSON with polygons"),
        (
            features(polygon(SQUARE), polygon([[20, 0], [21, 0], [21, 1], [20, 0]])),
            "1 of 2 polygons are outside the largest; .* of rooms that touch, save the union",
        ),
        (features(polygon([[0, 0], [1, 0]])), "coordinates: expected rings of at least"),
        (polygon([[0, 0], [1, "a"], [1, 1]]), "coordinates: expected pairs of numbers"),
        (polygon([]), "coordinates: expected lists of pairs"),
        ({"type": "Polygon", "coordinates": 5}, "coordinates: expected lists of pairs"),
        ({"type": "FeatureCollection", "features": [5]}, "whose features are objects"),
        ({"verts": 5}, "verts: expected a list"),
    ],
)
def test_other_plans_are_refused(tmp_path, document, message):
    (tmp_path / "plan.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match=message):
        Workspace.load(tmp_path / "plan.json")


@pytest.mark.parametrize(
    ("options", "positions"),
    [("", 24), ("--piece all", 25), ("--piece 4.25,1.75", 1), ("--crop 0,0,2,1.5", 6)],
)
def test_commands_have_the_options(tmp_path, capsys, options, positions):
    path = save(tmp_path)
    assert main(["groups", str(path), "--bounce", "90", "--json", *options.split()]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["positions"] == positions
    assert ("set --piece" in err) == (not options)
