import math
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr
import shapely
from recordings import read_back

import jaxcell.record.bounce.groups
from jaxcell import bundled
from jaxcell.bounce import BounceGroups
from jaxcell.record import save_recording
from jaxcell.record.canvas.map import CellMap
from jaxcell.record.canvas.palette import FREE, OBSTACLE
from jaxcell.record.canvas.stream import new_stream, recording
from jaxcell.space import CellSpace


@pytest.fixture(scope="module")
def recorded(lab):
    return read_back(lab.groups, {"who|what": "a test"})


def test_pictures_say_what_the_groups_are(lab, recorded):
    steps = lab.host().step.tolist()
    expected = {
        "groups": ["leads to the largest group" if n else "on the largest group" for n in steps],
        "steps": [f"{n} mapping{'s' * (n > 1)} to a group" if n else "on a group" for n in steps],
    }
    for name, labels in expected.items():
        shown = recorded.labels(f"/map/grid/bounce_45/{name}", "direction")
        assert list(shown) == list(range(8))
        assert np.stack([*shown.values()])[:, lab.cells.free].ravel().tolist() == labels
        for picture in shown.values():
            np.testing.assert_array_equal(picture == "not free", ~lab.cells.free)


def test_cycles_run_where_some_direction_is_periodic(lab, recorded):
    cycles = recorded.labels("/map/grid/bounce_45/cycles", "direction")
    periodic = (lab.host().step == 0).reshape(lab.cells.directions, -1).any(axis=0)
    expected = np.where(periodic, "on the largest group", "on no such group")
    # One group passes in all directions.
    for picture in cycles.values():
        np.testing.assert_array_equal(picture[lab.cells.free], expected)


def test_y_points_up(lab, recorded):
    """Pixels of the lowest row end up lowest on the screen, where y points down."""
    (flip,) = recorded.static("/map", "Transform3D:scale")
    (stretch,) = recorded.static("/map/grid", "Transform3D:scale")
    (shift,) = recorded.static("/map/grid", "Transform3D:translation")
    assert flip == [1, -1, 1]
    np.testing.assert_array_equal(recorded.picture("/map/grid/free"), lab.cells.free)
    row, column = np.divmod(lab.cells.square, lab.cells.free.shape[1])
    pixel = np.stack([column + 0.5, row + 0.5, 0 * row], axis=1)
    x, y, _ = (np.array(flip) * (pixel * stretch + shift)).T
    centre_x, centre_y, _ = lab.cells.centre(np.arange(lab.cells.positions))
    np.testing.assert_allclose(x, centre_x)
    np.testing.assert_allclose(-y, centre_y)


def test_a_label_knows_the_ground_below_its_mark(lab):
    cells = lab.cells
    map = CellMap(new_stream("test"), cells)
    below = np.vstack([np.zeros_like(cells.free[:1]), cells.free[:-1]])
    free = below.ravel()[cells.square]
    for position, is_free in enumerate(free.tolist()):
        place = map.xy(np.array(position))
        at, ground = map.below(place, cells.cell / 2)
        np.testing.assert_allclose(place - at, [0, cells.cell / 2])
        assert ground == (FREE if is_free else OBSTACLE)
    assert 0 < free.sum() < free.size


def test_walls_are_the_edges_of_free_squares(lab, recorded):
    strips = recorded.static("/map/walls", "LineStrips2D:strips")
    x, y, _ = lab.cells.centre(np.arange(lab.cells.positions))
    free = shapely.union_all(shapely.box(x - 0.25, y - 0.25, x + 0.25, y + 0.25))
    outlines = shapely.union_all([shapely.LineString(strip) for strip in strips])
    assert outlines.equals(free.boundary)


def test_walls_of_a_map(hall):
    recorded = read_back(hall.groups)
    strips = recorded.static("/map/walls", "LineStrips2D:strips")
    corners = {tuple(np.round(corner, 4)) for strip in strips for corner in strip}
    assert {(0, 0), (0, 4), (1, 1), (2, 2.2), (4, 1.5)} <= corners
    # A square is free, in an obstacle, or in the margin that the centre of the robot keeps.
    squares = recorded.picture("/map/grid/free")
    np.testing.assert_array_equal(squares == 1, hall.cells.free)
    assert squares[0, 0] == 2, "0.125 m from the wall, with a radius of 0.15 m"
    beyond = recorded.picture("/map/beyond")
    side = 0.25 / 8
    rows, columns = np.indices(beyond.shape)
    environment = hall.cells.workspace.environment
    inside = shapely.intersects_xy(environment, (columns + 0.5) * side, (rows + 0.5) * side)
    np.testing.assert_array_equal(beyond == 0, inside)
    (stretch,) = recorded.static("/map/beyond", "Transform3D:scale")
    assert stretch == [side, side, 1]


def test_walls_cover_squares_that_reach_past_them():
    """Pixels of 0.1 m beside cells of 0.25 m: what is beyond the walls is exact."""
    for cell in (0.1, 0.25):
        cells = CellSpace.load(bundled("office"), cell=cell, directions=4)
        recorded = read_back(BounceGroups.of(cells, math.radians(90)))
        if cell == 0.1:
            assert "/map/beyond" not in recorded.entities
            continue
        ((side, *_),) = recorded.static("/map/beyond", "Transform3D:scale")
        pixels = round(0.1 / side)
        beyond = recorded.picture("/map/beyond")[::pixels, ::pixels]
        native = CellSpace.load(bundled("office"), directions=4).free
        rows, columns = native.shape
        np.testing.assert_array_equal(beyond[:rows, :columns] == 0, native)


def test_groups_past_the_seventh_are_pale_and_families_apart(hall):
    """By 90 of 360 degrees, only headings 90 degrees apart share groups."""
    recorded = read_back(hall.groups)
    pictures = recorded.pictures("direction", "/map/grid/bounce_90/groups")
    labels = recorded.over("direction", "/bounce_90/legend/text", "Points2D:labels")
    rows = recorded.over("direction", "/bounce_90/legend/swatch", "LineStrips2D:strips")
    host = hall.host()
    met, on = host.group.reshape(24, -1), host.step.reshape(24, -1) == 0
    for direction in range(24):
        # Rank by the cells that reach a group, which the family of four directions holds.
        family = met[direction % 6 :: 6]
        numbers, basin = np.unique(family, return_counts=True)
        ranked = numbers[np.argsort(-basin, kind="stable")]
        place = (met[direction][:, None] == ranked).argmax(axis=1)
        place = np.where(place < 7, place, 7 + place % 7)
        shown = pictures[direction][hall.cells.free]
        np.testing.assert_array_equal(shown, 1 + 2 * place + on[direction])
        legend = labels[direction]
        drawn = np.unique(np.array(rows[direction])[:, 0, 1].round())
        np.testing.assert_array_equal(drawn, np.arange(len(legend)))
        for place, group in enumerate(ranked[:7]):
            assert legend[place].startswith(
                f"group {group}: period {host.period[host.group == group][0]},"
            )
        if len(ranked) == 8:
            assert legend[7].startswith(f"group {ranked[7]}: period")
        elif len(ranked) > 7:
            assert legend[7].startswith(f"{len(ranked) - 7} more, in pale colours")
        assert "dark shade of a colour: on the group itself" in legend
        assert "on no such group" in legend
        shares = [float(t.split()[-4]) for t in legend if t.endswith("% of cells")]
        assert sum(shares) == pytest.approx(100, abs=1.5)
        assert f"heading {15 * direction}°" in legend


def test_a_tab_for_each_angle(angles):
    recorded = read_back(angles)
    for i, name in enumerate(("bounce_45", "bounce_90", "bounce_135")):
        pictures = recorded.pictures("direction", f"/map/grid/{name}/steps")
        white = sum(int(np.sum(picture == 1)) for picture in pictures.values())
        assert white == np.sum(angles.step[i] == 0)
        text = recorded.text(f"/{name}/text")
        assert f"**{name.removeprefix('bounce_')}°**" in text
    column = "ContainerBlueprint:display_name"
    names = [name for one in recorded.blueprint.values() for name in one.get(column) or []]
    assert {"bounce 45°", "bounce 90°", "bounce 135°"} <= set(names)


def test_the_text_describes_the_groups(recorded):
    text = recorded.text("/bounce_45/text")
    (kind,) = recorded.static("/bounce_45/text/0", "TextDocument:media_type")
    assert kind == "text/markdown"
    for phrase in ("turns by **45°**", "**152 cells**", "There is **one**, with period 20"):
        assert phrase in text
    assert "| who|what | a test |" in text.replace("&#124;", "|")


@pytest.mark.parametrize("limit", [0, 1000, 100_000])
def test_a_full_disk_leaves_no_file(lab, tmp_path, limit):
    resource = pytest.importorskip("resource")
    path = tmp_path / "a.rrd"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        with pytest.raises(OSError, match="too large"):
            save_recording(lab.groups, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_bad_arguments_to_rerun_raise(tmp_path):
    # Without strict mode, Rerun would warn.
    message = "could not convert string"
    with pytest.raises(ValueError, match=message), recording(tmp_path / "a.rrd", "test") as stream:
        stream.log("number", rr.Scalars("none"))
    assert not list(tmp_path.iterdir())


def test_refuses_a_bad_path(lab, tmp_path):
    with pytest.raises(ValueError, match=r"a\.nc: expected .* ends in \.rrd"):
        save_recording(lab.groups, tmp_path / "a.nc")
    with pytest.raises(FileNotFoundError, match="no folder"):
        save_recording(lab.groups, tmp_path / "b" / "a.rrd")


def test_rerun_is_imported_on_first_use():
    code = "import sys, jaxcell.record as r; assert 'rerun' not in sys.modules; r.RobotRecording"
    code += "; assert 'rerun' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match=r"No jaxcell\.record attribute nothing"):
        jaxcell.record.nothing  # noqa: B018
