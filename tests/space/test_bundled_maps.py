import runpy
from pathlib import Path

import numpy as np
import pytest
import shapely

from jaxcell.space import Workspace


MAPS = Path(__file__).parents[2] / "data" / "maps"
NAMES = sorted(file.name for file in MAPS.iterdir() if file.suffix in (".json", ".txt", ".yaml"))


def load(name):
    return Workspace.load(MAPS / name)


def free_cells(room):
    (xmin, ymin), (xmax, ymax) = room.boundary.min(axis=0), room.boundary.max(axis=0)
    x = np.arange(xmin + room.cell / 2, xmax, room.cell)
    y = np.arange(ymin + room.cell / 2, ymax, room.cell)
    return int(shapely.contains_xy(room.free_space, *np.meshgrid(x, y)).sum())


def test_running_the_script_again_gives_the_same_bytes(tmp_path):
    runpy.run_path(str(MAPS / "make_maps.py"))["main"](tmp_path)
    made = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    kept = {name: (MAPS / name).read_bytes() for name in made}
    assert made == kept
    assert sorted(made) == sorted([*NAMES, "office.pgm"])


@pytest.mark.parametrize("name", NAMES)
def test_every_map_is_in_the_readme_and_loads_in_one_piece(name):
    assert f"`{name}`" in (MAPS / "README.md").read_text()
    room = load(name)
    assert room.pieces == 1
    assert room.name
    assert room.cell is not None
    assert free_cells(room) > 0


@pytest.mark.parametrize(
    ("name", "area", "obstacles"),
    [
        ("lab_a.json", 19, [(1, 1, 3, 3), (4, 0, 7, 3)]),
        ("lab_b.json", 19, [(2, 1, 5, 3), (0, 0, 1, 1), (4, 0, 6, 1), (0, 4, 1, 5), (5, 4, 6, 5)]),
    ],
)
def test_labs_have_the_obstacles_of_the_dissertation(name, area, obstacles):
    lab = load(name)
    assert [shapely.Polygon(ring).bounds for ring in lab.obstacles] == obstacles
    assert free_cells(lab) == lab.free_space.area == area
    assert (lab.cell, lab.directions, lab.robot_radius) == (1, 8, 0)


def test_the_room_of_figure_2_6_has_four_separate_obstacles():
    room = load("room_200x125.json")
    assert shapely.Polygon(room.boundary).bounds == (0, 0, 200, 125)
    assert all((ring == np.round(ring)).all() for ring in room.obstacles)
    polygons = [shapely.Polygon(ring) for ring in room.obstacles]
    walls = shapely.Polygon(room.boundary).exterior
    assert sorted(walls.distance(polygon) > 0 for polygon in polygons) == [False, True, True, True]
    assert sorted(len(ring) for ring in room.obstacles) == [4, 4, 4, 6]
    for k, polygon in enumerate(polygons):
        assert all(polygon.distance(other) >= 1 for other in polygons[:k])
    assert free_cells(room) == room.free_space.area == 22407


def test_arena_has_a_curved_wall():
    arena = load("arena.json")
    assert len(arena.boundary) > 48
    room = shapely.Polygon(arena.boundary)
    assert room.area == pytest.approx(4 * 3 + np.pi * 1.5**2 / 2, rel=1e-3)


def test_no_two_walls_of_the_slanted_room_are_parallel():
    room = load("slanted.json")
    along = np.concatenate(
        [np.roll(ring, -1, 0) - ring for ring in (room.boundary, *room.obstacles)]
    )
    angles = np.sort(np.append(np.arctan2(*along.T) % np.pi, [0, np.pi / 2, np.pi]))
    assert np.diff(angles).min() > np.radians(1)


def test_office_keeps_what_was_seen():
    office = load("office.yaml")
    assert office.boundary.min(axis=0).tolist() == [-1.5, -2.0]
    assert office.cell == 0.1
    seen = {"corridor": (3, 1.0), "a door": (0.6, 0.7), "a room": (0.0, 3.2)}
    hidden = {"outside": (-1.4, 0), "the room never entered": (5, 3), "a wall": (2.0, -1.0)}
    assert all(office.free_space.contains(shapely.Point(p)) for p in seen.values())
    assert not any(office.free_space.intersects(shapely.Point(p)) for p in hidden.values())
