import io
import re

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import example, given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from scipy import ndimage

from jaxcell.space import Workspace
from jaxcell.space.maps.grid_files import parse_ascii
from jaxcell.space.occupancy import blocked_rings, rasterise


grids = arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=9))


def text_of(blocked):
    """The rows of an ASCII grid; row 0 of the array is the lowest."""
    return "\n".join("".join("#."[1 - b] for b in row) for row in blocked[::-1].tolist())


def refuse(path, message):
    """Check that loading a map raises an error that begins with its path and a message."""
    with pytest.raises(ValueError, match="^" + re.escape(f"{path}: {message}")):
        Workspace.load(path)


def centres(grid, cell=1.0, origin=(0.0, 0.0)):
    rows, columns = np.indices(grid.shape)
    return origin[0] + (columns + 0.5) * cell, origin[1] + (rows + 0.5) * cell


RING = np.ones((5, 5), bool)
RING[1:4, 1:4] = False
RING[2, 2] = True


@given(grids)
@example(RING)
@example(np.eye(4, dtype=bool))
@example(np.indices((5, 6)).sum(axis=0) % 2 == 0)
@example(np.ones((2, 3), bool))
@example(np.zeros((1, 1), bool))
def test_blocked_rings_tile_the_blocked_squares(blocked):
    rings = np.split(*blocked_rings(blocked)) if blocked.any() else []
    polygons = [shapely.Polygon(ring) for ring in rings]
    assert all(polygon.is_valid and polygon.exterior.is_ccw for polygon in polygons)
    assert sum(polygon.area for polygon in polygons) == blocked.sum()
    for row, column in np.ndindex(blocked.shape):
        square = shapely.box(column, row, column + 1, row + 1)
        covering = [polygon for polygon in polygons if polygon.covers(square)]
        assert len(covering) == blocked[row, column]
    for ring in rings:
        turns = np.diff(np.vstack([ring, ring[:2]]), axis=0)
        assert (np.sign(turns[1:]) != np.sign(turns[:-1])).any(axis=1).all()


def test_a_rectangle_is_one_polygon():
    blocked = np.zeros((9, 9), bool)
    blocked[2:5, 3:8] = True
    assert len(np.split(*blocked_rings(blocked))) == 1
    assert len(np.split(*blocked_rings(RING[:, ::-1]))) == 5


@given(grids, st.sampled_from([1.0, 0.05, 1 / 3, 0.0254]), st.sampled_from([(0, 0), (-3.7, 12)]))
@example(RING, 0.1, (0.3, -0.7))
def test_a_grid_is_free_where_its_squares_are(blocked, cell, origin):
    text = f"; cell {cell!r}\n; origin {origin[0]} {origin[1]}\n{text_of(blocked)}\n"
    if blocked.all():
        with pytest.raises(ValueError, match="the grid has no free square"):
            parse_ascii(text)
        return
    room = Workspace(**parse_ascii(text))
    x, y = centres(blocked, cell, origin)
    assert np.array_equal(shapely.contains_xy(room.free_space, x, y), ~blocked)
    assert room.free_space.area == pytest.approx((~blocked).sum() * cell**2)
    assert room.cell == cell
    # Squares that meet in a corner only do not hang together.
    assert room.pieces == ndimage.label(~blocked)[1]


@given(grids.filter(lambda grid: not grid.all()), st.sampled_from([1.0, 0.05, 1 / 3]))
def test_ascii_and_map_server_round_trip(tmp_path_factory, blocked, cell):
    folder = tmp_path_factory.mktemp("maps")
    room = Workspace(
        **parse_ascii(f"; name my room\n; cell {cell!r}\n; origin -1.5 0.25\n" + text_of(blocked))
    )
    for name in ("room.txt", "room.map", "room.yaml", "room.yml"):
        room.save(folder / name)
        again = Workspace.load(folder / name)
        assert again.free_space.equals(room.free_space)
        assert again.cell == cell
        assert again.name == ("room" if "y" in name else "my room")


def test_a_polygon_map_is_saved_as_a_grid(tmp_path):
    room = Workspace(
        [(1, 2), (4.3, 2), (1, 5)], robot_radius=0.1, name="wedge", cell=0.5, directions=12
    )
    room.save(tmp_path / "wedge.txt")
    assert (tmp_path / "wedge.txt").read_text() == (
        "; name wedge\n; cell 0.5\n; robot_radius 0.1\n; directions 12\n; origin 1.0 2.0\n"
        ".######\n..#####\n...####\n....###\n.....##\n......#\n"
    )
    grid = Workspace.load(tmp_path / "wedge.txt")
    assert (grid.robot_radius, grid.directions, grid.name) == (0.1, 12, "wedge")


def test_a_map_without_a_fitting_cell_is_not_saved_as_a_grid(tmp_path):
    with pytest.raises(ValueError, match=r"room\.txt: cell: a grid needs the side of its squares"):
        Workspace([(0, 0), (1, 0), (1, 1)]).save(tmp_path / "room.txt")
    with pytest.raises(ValueError, match=r"room\.yaml: cell: no square of side 9 m has its centre"):
        Workspace([(0, 0), (1, 0), (1, 1)], cell=9).save(tmp_path / "room.yaml")
    with pytest.raises(ValueError, match=r"cell: squares of 1e-05 m make a grid of 100000 x 1"):
        Workspace([(0, 0), (1, 0), (1, 1)], cell=1e-5).save(tmp_path / "room.yaml")
    assert list(tmp_path.iterdir()) == []


def test_rasterise_counts_squares_in_spite_of_rounding():
    for bounds, cell, shape in [
        ((0.0, 0.0, 0.3, 0.1 + 0.2), 0.1, (3, 3)),
        ((0.1, 0.7, 0.4, 1.3), 0.1, (6, 3)),
        ((0.0, 0.0, 1.0, 1.0), 0.4, (3, 3)),
    ]:
        assert rasterise(shapely.box(*bounds), bounds, cell).shape == shape


def test_fields_of_an_ascii_header_are_read():
    fields = parse_ascii(
        ";; a remark\n;\n; name  Long   Hall \r\n;cell 0.25\n; robot_radius 0.1\n\n"
        "; directions 16\n; origin -1 2.5\n#X@\n#. \n\n\n"
    )
    assert fields["name"] == "Long   Hall"
    assert (fields["cell"], fields["robot_radius"], fields["directions"]) == (0.25, 0.1, 16)
    assert fields["boundary"].tolist() == [[-1, 2.5], [-0.25, 2.5], [-0.25, 3], [-1, 3]]
    free = Workspace(**fields | {"robot_radius": 0.0}).free_space
    assert free.equals(shapely.box(-0.75, 2.5, -0.25, 2.75))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the grid has no rows"),
        ("; cell 1\n\n", "the grid has no rows"),
        ("##\n##\n", "the grid has no free square"),
        ("...\n.t.\n", "line 2, column 2: expected one of '#X@' (blocked) or '. ' (free), got 't'"),
        ("; cell 1\n...\n..\n", "line 3: the row has 2 squares, but the first row, line 2, has 3"),
        ("...\n\n...\n", "line 2: the row has 0 squares"),
        ("...\n; cell 1\n", "line 2, column 1: expected one of '#X@' (blocked)"),
        (".\u00e9.\n", "line 1, column 2: "),
        ("...\r...\n", "line 1, column 4: "),
        ("; cel 1\n...\n", "line 1: 'cel': unknown; expected name, cell, origin, robot_radius"),
        ("; cell 1\n; cell 2\n...\n", "line 2: 'cell' is given twice"),
        ("; cell\n...\n", "cell: expected a finite number, got ''"),
        ("; cell wide\n...\n", "cell: expected a finite number, got 'wide'"),
        ("; cell nan\n...\n", "cell: expected a finite number, got 'nan'"),
        ("; cell 1e7\n...\n", "boundary: vertex 1 is (3e+07, 0)"),
        ("; origin 1\n...\n", "origin: expected two numbers x y, got '1'"),
        ("; origin 1 inf\n...\n", "origin: expected a finite number, got 'inf'"),
        ("; directions 8.5\n...\n", "directions: expected a whole number, got '8.5'"),
    ],
)
def test_bad_ascii_grids_are_refused(tmp_path, text, message):
    path = tmp_path / "grid.txt"
    path.write_bytes(text.encode())
    refuse(path, message)


MAP = {"resolution": 0.5, "origin": [-1.0, 2.0, 0.0], "negate": 0}
MAP |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
# Top row: free, the last free shade, the first unknown, unknown, occupied.
SHADES = np.array([[255, 206, 205, 128, 0], [254, 254, 0, 0, 255]], np.uint8)
SHADES_FREE = np.array([[1, 1, 0, 0, 0], [1, 1, 0, 0, 1]], bool)


def save_map(folder, pixels=SHADES, file="map.pgm", **changes):
    """Writes a map_server map; the pixels are an array, a Pillow image, or a file's bytes."""
    fields = {"image": file} | MAP | changes
    document = {key: value for key, value in fields.items() if value is not ...}
    (folder / "map.yaml").write_text(yaml.safe_dump(document))
    if isinstance(pixels, bytes):
        (folder / file).write_bytes(pixels)
    else:
        image = Image.fromarray(pixels) if isinstance(pixels, np.ndarray) else pixels
        image.save(folder / file)
    return folder / "map.yaml"


def free_pixels(path):
    """The mask of free pixels of a map, row 0 at the top."""
    room = Workspace.load(path)
    rows, columns = np.round(np.ptp(room.boundary, axis=0) / room.cell).astype(int)[::-1]
    x, y = centres(np.empty((rows, columns)), room.cell, room.boundary.min(axis=0))
    return shapely.contains_xy(room.free_space, x, y)[::-1]


def test_a_map_server_map_is_read(tmp_path):
    room = Workspace.load(save_map(tmp_path))
    assert (room.name, room.cell, room.robot_radius) == ("map", 0.5, 0.0)
    assert room.boundary.tolist() == [[-1, 2], [1.5, 2], [1.5, 3], [-1, 3]]
    assert room.free_space.equals(shapely.box(-1, 2, 0, 3) | shapely.box(1, 2, 1.5, 2.5))
    assert room.pieces == 2


def transparent_palette():
    """An opaque and a transparent white pixel."""
    image = Image.fromarray(np.array([[0, 1]], np.uint8)).convert("P")
    image.putpalette([255, 255, 255, 255, 255, 255])
    image.info["transparency"] = 1
    return image


# Opaque black is occupied, opaque white free, and a transparent white pixel unknown.
ALPHA = np.array([[[0, 255], [255, 255], [255, 0], [255, 60]]], np.uint8)


@pytest.mark.parametrize(
    ("image", "free"),
    [
        pytest.param(SHADES, SHADES_FREE, id="grey"),
        pytest.param(np.stack([SHADES] * 3, axis=2), SHADES_FREE, id="RGB"),
        pytest.param(SHADES.astype(np.uint16) * 257, SHADES_FREE, id="16 bits"),
        pytest.param(Image.fromarray(SHADES).convert("P"), SHADES_FREE, id="palette"),
        pytest.param(Image.fromarray(SHADES_FREE), SHADES_FREE, id="one bit"),
        pytest.param(
            np.array([[[255, 255, 106], [255, 255, 105], [255, 0, 0]]], np.uint8),
            [[True, False, False]],
            id="colours",
        ),
        pytest.param(transparent_palette(), [[True, False]], id="transparent palette"),
        pytest.param(ALPHA, [[False, True, False, True]], id="LA"),
        pytest.param(ALPHA[..., [0, 0, 0, 1]], [[False, True, False, True]], id="RGBA"),
        *(
            (content, [[0, 1, 1], [0, 0, 1]])
            for content in (
                b"P2\n# a remark\n3 2\n255\n0 254 254\n0 0 254\n",
                b"P5\n3 2\n255\n\x00\xfe\xfe\x00\x00\xfe",
                b"P5 3 2 65535 \x00\x00\xfe\x00\xfe\x00\x00\x00\x00\x00\xfe\x00",
                b"P5\n3 2\n100\n\x00\x63\x63\x00\x00\x63",
            )
        ),
    ],
)
def test_channels_of_images_are_averaged_as_map_server_does(tmp_path, image, free):
    path = save_map(tmp_path, image, "map.png")
    np.testing.assert_array_equal(free_pixels(path), free)


@pytest.mark.parametrize("negate", [1, True, "True"])
def test_negated_shades_are_read(tmp_path, negate):
    assert np.array_equal(free_pixels(save_map(tmp_path, 255 - SHADES, negate=negate)), SHADES_FREE)


@given(
    shades=arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=6)),
    free=st.floats(0, 1),
    negate=st.booleans(),
)
def test_pixels_below_the_threshold_are_free(tmp_path_factory, shades, free, negate):
    # Grey that savers write for unknown has tests of its own.
    shades = np.where(np.isin(shades, [127, 128, 205]), 129, shades).astype(np.uint8)
    expected = (shades / 255.0 if negate else (255 - shades.astype(float)) / 255.0) < free
    changes = {"free_thresh": free, "occupied_thresh": 1.0, "negate": int(negate)}
    path = save_map(tmp_path_factory.mktemp("maps"), shades, **changes)
    if expected.any():
        assert np.array_equal(free_pixels(path), expected)
    else:
        refuse(path, "the grid has no free square")


def test_numbers_that_are_text_in_yaml_1_1_are_read(tmp_path):
    path = save_map(tmp_path)
    path.write_text(path.read_text().replace("resolution: 0.5", "resolution: 5e-1"))
    assert Workspace.load(path).cell == 0.5


def test_the_image_is_relative_to_the_yaml_file(tmp_path, monkeypatch):
    (tmp_path / "maps").mkdir()
    save_map(tmp_path / "maps")
    monkeypatch.chdir(tmp_path)
    assert Workspace.load("maps/map.yaml").cell == 0.5
    path = save_map(tmp_path, image=str(tmp_path / "maps" / "map.pgm"))
    assert Workspace.load(path).cell == 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resolution": ...}, "resolution: it is missing; a map_server file has image, resolution"),
        ({"resolution": "fine"}, "resolution: expected a finite number, got 'fine'"),
        ({"resolution": 0.0}, "resolution: expected more than 0 m, got 0"),
        ({"resolution": [0.1]}, "resolution: expected a finite number, got ['0.1']"),
        ({"origin": [0, 0]}, "origin: expected [x, y, yaw], got ['0', '0']"),
        ({"origin": 0}, "origin: expected [x, y, yaw], got '0'"),
        ({"origin": [0, float("nan"), 0]}, "origin: expected a finite number, got '.nan'"),
        ({"negate": 2}, "negate: expected 0 or 1, got '2'"),
        ({"mode": "costs"}, "mode: expected trinary, scale or raw, got 'costs'"),
        ({"free_thresh": 0.7}, "free_thresh, occupied_thresh: expected 0 <= free_thresh"),
        ({"free_thresh": 0.0}, "the grid has no free square"),
        ({"image": ""}, "image: expected the name of a file, got ''"),
        ({"image": ["map.pgm"]}, "image: expected the name of a file, got ['map.pgm']"),
    ],
)
def test_bad_map_server_fields_are_refused(tmp_path, changes, message):
    refuse(save_map(tmp_path, **changes), message)


def test_a_missing_image_is_refused(tmp_path):
    path = save_map(tmp_path)
    (tmp_path / "map.pgm").unlink()
    refuse(path, "image: map.pgm: No such file")
    (tmp_path / "map.pgm").mkdir()
    refuse(path, "image: map.pgm: Is a directory")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected a map_server description"),
        ("- 1\n", "expected a map_server description"),
        ("image: [\n", "not valid YAML, or cut short: "),
        ("image: \x07\n", "not valid YAML, or cut short: "),
        ("[" * 5000, "not valid YAML, or cut short: "),
        ("? [a, b]\n: c\n", "not valid YAML, or cut short: "),
        ("image: *a\n", "not valid YAML, or cut short: "),
        ("image: !!python/object:os.system x\n", "resolution: it is missing"),
    ],
)
def test_other_yaml_is_refused(tmp_path, content, message):
    path = tmp_path / "map.yaml"
    path.write_text(content)
    refuse(path, message)


def png(array):
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, "PNG")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected a PGM, PNG or BMP image"),
        (b"GIF89a", "expected a PGM, PNG or BMP image"),
        (b"P5\n0 0\n255\n", "expected a PGM, PNG or BMP image"),
        (b"P5\n2 2\n0\n\x00\x00\x00\x00", "broken or cut short; copy or save"),
        (b"P5\n20000 20000\n255\n", "too large: 20,000 x 20,000 pixels; expected at most"),
        (b"P5\n2 2\n255\n\xfe\xfe\xfe", "broken or cut short; copy or save"),
        (b"P2\n2 2\n255\n254 254 25x 254", "broken or cut short; copy or save"),
        (b"Pf\n1 1\n1.0\n\x00\x00\x00\x00", "expected grey or colour of 8 bits, or grey of 16"),
    ],
)
def test_bad_images_are_refused(tmp_path, content, message):
    refuse(save_map(tmp_path, content), f"image: map.pgm: {message}")


@pytest.mark.parametrize(
    ("content", "least"),
    [
        (b"P5\n5 2\n255\n" + SHADES.tobytes(), 0),
        (b"P5\n3 2\n100\n\x00\x63\x63\x00\x00\x63", 0),
        # The last number may lose digits unnoticed: it ends where the file does.
        (b"P2\n3 2\n255\n0 254 254\n0 0 254", 2),
        # The check sum, the end mark, and bits that pad the stream.
        (png(SHADES), 24),
        (png(np.stack([SHADES] * 4, axis=2)), 24),
    ],
    ids=["PGM", "PGM of other depth", "plain PGM", "PNG", "PNG with alpha"],
)
def test_every_cut_of_an_image_is_refused(tmp_path, content, least):
    """The last `least` bytes may be missing without loss of a pixel."""
    assert free_pixels(save_map(tmp_path, content)).any()
    for end in range(len(content) - least):
        refuse(save_map(tmp_path, content[:end]), "image: map.pgm: ")
