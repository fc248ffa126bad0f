"""Pixels of maps whose saver did not know what is there."""

import json

import numpy as np
import pytest
import shapely
from PIL import Image

from jaxcell.base.doubts import Doubt
from jaxcell.cli import main
from jaxcell.space import Workspace


# A room of 6 x 4 pixels with a wall around it, and three unexplored columns beside it.
ROOM = np.full((6, 11), 205, np.uint8)
ROOM[:, :8] = 0
ROOM[1:-1, 1:7] = 254


def save(folder, pixels, mode="", free=0.25, **more):
    """Write a map with pixels of a side of 1 m, and the thresholds of a saver."""
    Image.fromarray(pixels).save(folder / "map.png")
    lines = ["image: map.png", "resolution: 1.0", "origin: [0, 0, 0]", "negate: 0"]
    lines += ["occupied_thresh: 0.65", f"free_thresh: {free}", *([f"mode: {mode}"] if mode else [])]
    (folder / "map.yaml").write_text("\n".join(lines))
    return folder / "map.yaml"


def free_of(path, **options):
    """The mask of free pixels, row 0 at the top, asked of the middle of each pixel."""
    room = Workspace.load(path, **options)
    width, height = np.ptp(room.boundary, axis=0).astype(int)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return shapely.contains_xy(room.free_space, x, y)[::-1]


@pytest.mark.parametrize("grey", [205, 127, 128])
def test_the_grey_of_unknown_is_wall_although_the_threshold_takes_it_as_free(tmp_path, grey):
    pixels = np.where(ROOM == 205, grey, ROOM).astype(np.uint8)
    path = save(tmp_path, pixels, free=0.6)
    with pytest.warns(Doubt, match=f"map.png: 18 pixels of grey {grey} are walls: free_thresh 0.6"):
        np.testing.assert_array_equal(free_of(path), pixels == 254)
    np.testing.assert_array_equal(free_of(path, unknown="free"), pixels > 0)


@pytest.mark.parametrize("mode", ["", "trinary"])
def test_unknown_in_colours_and_16_bits_is_wall(tmp_path, mode):
    for pixels in (np.stack([ROOM] * 3, axis=2), ROOM.astype(np.uint16) * 257):
        with pytest.warns(Doubt, match="18 pixels of grey 205"):
            np.testing.assert_array_equal(free_of(save(tmp_path, pixels, mode)), ROOM == 254)


@pytest.mark.filterwarnings("error", "ignore:map. the free space has 2 separate pieces")
def test_unknown_between_the_thresholds_is_wall_without_a_doubt(tmp_path):
    path = save(tmp_path, ROOM, free=0.196)
    np.testing.assert_array_equal(free_of(path), ROOM == 254)
    np.testing.assert_array_equal(free_of(path, unknown="free"), ROOM > 0)


@pytest.mark.filterwarnings("error")
def test_a_map_of_all_greys_has_none_for_unknown(tmp_path):
    """Shades of a probability, of which 205 is as frequent as its neighbours."""
    pixels = np.repeat(np.arange(180, 255, dtype=np.uint8)[None], 4, axis=0)
    np.testing.assert_array_equal(free_of(save(tmp_path, pixels)), (255 - pixels) / 255 < 0.25)


# White, opaque or not, and three colours: to the eye light green and pink are lighter than purple.
CLEAR = np.array([[[255, 255, 255, 255], [255, 255, 255, 254], [255, 255, 255, 0]]], np.uint8)
COLOURS = np.array([[[200, 255, 200], [255, 190, 200], [230, 130, 255], [255, 255, 0]]], np.uint8)


def test_files_with_a_mode_are_read_as_nav2_reads_them(tmp_path):
    np.testing.assert_array_equal(free_of(save(tmp_path, CLEAR, "trinary")), [[1, 0, 0]])
    path = save(tmp_path, CLEAR, "trinary")
    np.testing.assert_array_equal(free_of(path, unknown="free"), [[1, 1, 1]])
    # 0.2126 R + 0.7152 G + 0.0722 B: 239.3, 204.5, 160.3, 236.6 of 255; free from 191.25 on.
    np.testing.assert_array_equal(free_of(save(tmp_path, COLOURS, "trinary")), [[1, 1, 0, 1]])


def test_files_without_a_mode_are_read_as_in_ros_1_and_clear_pixels_are_counted(tmp_path):
    with pytest.warns(Doubt, match="map.png: 1 pixels that are not opaque are free, as in ROS 1"):
        np.testing.assert_array_equal(free_of(save(tmp_path, CLEAR)), [[1, 1, 0]])
    # Means of 218.3, 215, 205, 170 of 255.
    np.testing.assert_array_equal(free_of(save(tmp_path, COLOURS)), [[1, 1, 1, 0]])


COMMANDS = ["groups MAP --bounce 45", "patrol map MAP --robots 1"]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_prints_the_doubt_once_above_its_answer(tmp_path, capsys, command):
    path = str(save(tmp_path, ROOM, "trinary"))
    words = [path if word == "MAP" else word for word in command.split()]
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)
    assert err.count("map.png: 18 pixels of grey 205 are walls") == 1
    assert "free, use --unknown free" in err


def test_an_option_makes_unknown_pixels_free(tmp_path, capsys):
    path = save(tmp_path, ROOM, "trinary")
    assert main(["groups", str(path), "--bounce", "45", "--unknown", "free", "--json"]) == 0
    out, err = capsys.readouterr()
    assert "grey" not in err
    assert json.loads(out)["positions"] == 24 + 18


def test_unknown_pixels_of_other_maps_are_refused(capsys):
    assert main(["groups", "@lab_a", "--bounce", "45", "--unknown", "free"]) == 2
    assert "--unknown: expected a ROS map, .yaml; " in capsys.readouterr().err
