"""Make the maps of this folder: `python data/maps/make_maps.py [FOLDER]`.

The files have the same bytes on every machine. README.md describes each map.
"""

import math
import random
import sys
from pathlib import Path

import numpy as np
import shapely

from jaxcell.space import Workspace


def box(xmin: float, ymin: float, xmax: float, ymax: float) -> list[tuple[float, float]]:
    return [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]


def arc(
    x: float, y: float, radius: float, start_deg: float, end_deg: float, chords: int
) -> list[tuple[float, float]]:
    """Compute vertices along an arc, including both ends.

    They are rounded to millimetres, because the last digits of a cosine differ between machines.
    """
    angles = [
        math.radians(start_deg + (end_deg - start_deg) * k / chords) for k in range(chords + 1)
    ]
    return [
        (round(x + radius * math.cos(angle), 3), round(y + radius * math.sin(angle), 3))
        for angle in angles
    ]


def lab_a() -> Workspace:
    return Workspace(
        box(0, 0, 8, 4),
        [box(1, 1, 3, 3), box(4, 0, 7, 3)],
        name="Lab A, after Alam 2018, Figure 2.8(a)",
        cell=1,
        directions=8,
    )


def lab_b() -> Workspace:
    return Workspace(
        box(0, 0, 6, 5),
        [box(2, 1, 5, 3), box(0, 0, 1, 1), box(4, 0, 6, 1), box(0, 4, 1, 5), box(5, 4, 6, 5)],
        name="Lab B, a stand-in for Alam 2018, Figure 2.9(a)",
        cell=1,
        directions=8,
    )


def cafe() -> Workspace:
    pillar = arc(3.4, 2.6, 0.15, 0, 360, 12)[:-1]
    return Workspace(
        [(0, 0), (6, 0), (6, 3.5), (5, 3.5), (5, 5), (0, 5)],
        [
            box(0, 3.5, 2.75, 4.1),  # counter, with the barista's side behind it
            box(0.8, 0.6, 1.4, 1.2),  # tables
            box(0.8, 2.1, 1.4, 2.7),
            [(2.9, 1.0), (3.4, 0.5), (3.9, 1.0), (3.4, 1.5)],
            pillar,
            box(5.2, 0.7, 6, 2.2),  # sofa
            box(4.6, 4.6, 5, 5),  # plant
        ],
        robot_radius=0.17,
        name="Cafe, for a disc robot of the size of a Create 2",
        cell=0.25,
        directions=16,
    )


def room_200x125() -> Workspace:
    """Make a room with obstacles at random places, at least 1 m from walls and each other."""
    shapes = [
        box(0, 0, 25, 25),
        box(0, 0, 40, 18),
        [(0, 0), (36, 0), (36, 12), (12, 12), (12, 30), (0, 30)],
    ]
    obstacles = [box(70, 0, 100, 20)]
    draw = random.Random(26)
    for shape in shapes:
        width, height = np.max(shape, axis=0).tolist()
        while True:
            # Of all methods, only random() draws the same numbers in every version of Python.
            x = 1 + math.floor(draw.random() * (200 - width - 1))
            y = 1 + math.floor(draw.random() * (125 - height - 1))
            placed = [(x + dx, y + dy) for dx, dy in shape]
            others = shapely.MultiPolygon([shapely.Polygon(ring) for ring in obstacles])
            if shapely.distance(shapely.Polygon(placed), others) >= 1:
                break
        obstacles.append(placed)
    return Workspace(
        box(0, 0, 200, 125),
        obstacles,
        name="Room of 200 x 125, after Alam 2018, Figure 2.6",
        cell=1,
        directions=360,
    )


def arena() -> Workspace:
    return Workspace(
        [(0, 0), (4, 0), *arc(4, 1.5, 1.5, -90, 90, 48)[1:-1], (4, 3), (0, 3)],
        [arc(4, 1.5, 0.4, 0, 360, 24)[:-1], [(1, 0.8), (2.2, 1.5), (1, 2.2)]],
        name="Arena with a round end",
        cell=0.1,
        directions=36,
    )


def slanted() -> Workspace:
    return Workspace(
        [(0.4, 0), (5.8, 0.7), (7, 3.1), (5.9, 5.6), (3.6, 4.7), (1.9, 5.9), (0, 3.2)],
        [
            [(1.6, 1.3), (2.9, 1.6), (2.1, 2.9)],
            [(4.1, 1.7), (5.3, 2.4), (4.8, 3.3), (3.7, 2.8)],
            [(1.3, 3.8), (2.2, 3.6), (2.4, 4.4)],
        ],
        name="Room with slanted walls",
        cell=0.5,
        directions=16,
    )


def complex_room() -> Workspace:
    return Workspace(
        box(0, 0, 16, 13),
        [
            box(8, 6, 12, 8),
            box(3, 4, 5, 6),
            box(0, 3, 1, 6),
            box(1, 0, 6, 1),
            box(15, 2, 16, 7),
        ],
        name="Complex room, a stand-in for Alam 2018, Figure 3.9",
        cell=1,
        directions=8,
    )


def depot() -> Workspace:
    racks = [box(2, 2, 3, 6), box(4, 2, 5, 6), box(6, 2, 7, 6), box(9, 2, 10, 5)]
    walls = [
        box(0, 8, 2, 9),
        box(4, 8, 6, 9),
        box(7, 8, 8, 10),
        box(10, 7, 11, 11),
        box(12, 6, 13, 8),
        box(13, 10, 15, 11),
        box(2, 11, 5, 12),
        box(7, 13, 8, 15),
    ]
    pillars = [box(11, 3, 13, 4), box(11, 13, 12, 14)]
    return Workspace(box(0, 0, 15, 15), racks + walls + pillars, name="Depot", cell=1, directions=8)


def harbour() -> Workspace:
    return Workspace(
        box(0, 0, 18, 16),
        [
            box(3, 3, 6, 5),  # sheds
            box(5, 8, 6, 10),
            box(11, 11, 13, 12),
            box(12, 12, 13, 14),
            box(14, 7, 16, 9),
            box(2, 8, 3, 12),  # stacks
            box(5, 13, 8, 14),
            box(11, 2, 12, 5),
            box(12, 2, 15, 3),
            box(16, 4, 17, 5),
            box(8, 0, 9, 2),  # jetties
            box(15, 12, 18, 13),
        ],
        name="Harbour",
        cell=1,
        directions=8,
    )


MAZE = """\
;; A row of text is a row of squares; the first is the top one.
; name Maze
; cell 0.5
; directions 8
###################
#.....#.......#...#
#.###.#.#####.#.#.#
#.#.......#.....#.#
#.#.###.#.#.#####.#
#...#...#.........#
###.#.#####.###.###
#.....#.......#...#
#.#####.#####.###.#
#.......#.........#
###################
"""


def office_pixels() -> np.ndarray:
    """Make the pixels of three rooms on a corridor, of 10 cm each, with row 0 at the bottom."""
    wall, free, unknown = 0, 254, 205
    pixels = np.full((60, 90), unknown, np.uint8)
    pixels[4:56, 4:86] = wall
    for rows, columns in [
        (slice(6, 26), slice(6, 34)),
        (slice(6, 26), slice(36, 60)),
        (slice(6, 26), slice(62, 84)),
        (slice(28, 40), slice(6, 84)),
        (slice(42, 54), slice(6, 50)),
    ]:
        pixels[rows, columns] = free
    for rows, columns in [
        (slice(26, 28), slice(16, 26)),
        (slice(26, 28), slice(44, 54)),
        (slice(26, 28), slice(68, 78)),
        (slice(40, 42), slice(22, 34)),
    ]:
        pixels[rows, columns] = free  # doors
    for rows, columns in [
        (slice(6, 12), slice(6, 20)),
        (slice(18, 26), slice(36, 40)),
        (slice(12, 18), slice(68, 78)),
        (slice(46, 51), slice(10, 20)),
        (slice(33, 35), slice(48, 50)),
    ]:
        pixels[rows, columns] = wall  # furniture
    pixels[42:54, 52:84] = unknown  # a room that the robot did not enter
    return pixels


OFFICE = """\
image: office.pgm
resolution: 0.1
origin: [-1.5, -2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def main(folder: Path) -> None:
    for make in (lab_a, lab_b, cafe, room_200x125, arena, slanted, depot, harbour):
        make().save(folder / f"{make.__name__}.json")
    complex_room().save(folder / "complex.json")
    (folder / "maze.txt").write_bytes(MAZE.encode())
    pixels = office_pixels()
    rows, columns = pixels.shape
    image = f"P5\n{columns} {rows}\n255\n".encode() + pixels[::-1].tobytes()
    (folder / "office.pgm").write_bytes(image)
    (folder / "office.yaml").write_bytes(OFFICE.encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
