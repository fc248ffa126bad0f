"""Camera frames with and without the cross marker, drawn for tests and for `chapter_4/marker.py`.

Sheets stand in a room at a random pose and are seen by a pinhole camera: the plane of a sheet is
mapped to the frame by a homography. The scene is drawn at twice the size and averaged down, then
lit, blurred, and covered by noise. The marker's corners are written down here again, so that the
tests compare `jaxcell.robot.marker` with something other than itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np


WIDTH, HEIGHT = 640, 480
# The focal length of a Raspberry Pi's camera (62 degrees across), in widths of the frame.
FOCAL = 0.83
FINER = 2
SUBPIXEL = 4

Corners = np.ndarray


def plus(half: float, ends: tuple[float, float, float, float] = (3, 3, 3, 3)) -> Corners:
    """A cross of arms `2 * half` wide, that end so far right, down, left and up of its middle."""
    h, (right, down, left, up) = half, ends
    return np.array(
        [
            *[(-h, -up), (h, -up), (h, -h), (right, -h), (right, h), (h, h)],
            *[(h, down), (-h, down), (-h, h), (-left, h), (-left, -h), (-h, -h)],
        ]
    )


CROSS = plus(1)
"""The marker, from -3 to 3, in a sheet from -5 to 5."""
SHEET = np.array([(-5, -5), (5, -5), (5, 5), (-5, 5)])
INK, PAPER = 0.1, 0.9


@dataclass(frozen=True)
class Conditions:
    """Conditions of a picture of a marker. Ranges are sampled uniformly, spans by logarithm."""

    span: tuple[float, float] = (24.0, 200.0)
    "Length of an upright cross in the middle of the frame, pixels."
    rotation: tuple[float, float] = (0.0, 2 * math.pi)
    "Rotation in the plane of the sheet, radians."
    tilt: tuple[float, float] = (0.0, math.radians(45))
    "Tilt of the sheet away from the camera, radians."
    noise: tuple[float, float] = (0.0, 10.0)
    "Standard deviation, grey levels of 255."
    light: tuple[float, float] = (0.3, 1.0)
    "Brightness of white paper, as a share of full scale."
    glare: tuple[float, float] = (0.0, 0.5)
    "Share of light that one side of the frame lacks, and that a bright spot adds."
    blur: tuple[float, float] = (0.0, 1.0)
    "Standard deviation, pixels."
    hidden: tuple[float, float] = (0.0, 0.0)
    "Share of the span that an object in front hides from one side."
    things: int = 12
    "Pieces of clutter in the frame."


@dataclass(frozen=True)
class Seen:
    """A frame and where the marker is in it."""

    frame: np.ndarray
    centre: np.ndarray
    corners: Corners
    "Of the cross, pixels."


def with_marker(rng: np.random.Generator, conditions: Conditions) -> Seen:
    """A cluttered frame with the marker, whole within it."""
    canvas = room(rng, conditions.things)
    low, high = conditions.span
    for _ in range(1000):
        span = low * (high / low) ** rng.random()
        turned, tilt = rng.uniform(*conditions.rotation), rng.uniform(*conditions.tilt)
        pose = plane(rng, span / 6, turned, tilt)
        sheet = through(pose, SHEET)
        if (sheet > 2).all() and (sheet < (WIDTH - 2, HEIGHT - 2)).all():
            break
    else:
        raise ValueError(f"span: {span:g} px does not fit the frame")
    fill(canvas, sheet, PAPER)
    fill(canvas, through(pose, CROSS), INK)
    if hidden := rng.uniform(*conditions.hidden):
        # It comes over one of the four ends, and hides what it hides of the sheet as well.
        edge = 3 - 6 * hidden
        cover = np.array([(edge, -6), (9, -6), (9, 6), (edge, 6)])
        quarter = math.pi / 2 * rng.integers(4)
        fill(canvas, through(pose, cover @ rotation(quarter).T), rng.uniform(0.1, 0.8))
    frame = photograph(rng, canvas, conditions)
    return Seen(frame, through(pose, np.zeros((1, 2)))[0], through(pose, CROSS))


def without_marker(
    rng: np.random.Generator, conditions: Conditions, *, sign: str | None = None
) -> np.ndarray:
    """A cluttered frame; `sign` names another sign for up to six sheets."""
    canvas = room(rng, conditions.things)
    if sign is not None:
        low, high = conditions.span
        for _ in range(rng.integers(1, 7)):
            span = min(low * (high / low) ** rng.random(), 200.0)
            turned, tilt = rng.uniform(*conditions.rotation), rng.uniform(*conditions.tilt)
            pose = plane(rng, span / 6, turned, tilt)
            fill(canvas, through(pose, SHEET), PAPER)
            for shape, shade in SIGNS[sign](rng):
                fill(canvas, through(pose, shape), shade)
    return photograph(rng, canvas, conditions)


# The camera.


def plane(rng: np.random.Generator, unit: float, turned: float, tilt: float) -> np.ndarray:
    """The homography of a plane that is turned, then tilted about any axis, then put anywhere.

    A unit of the plane is `unit` pixels long if it is not tilted.
    """
    axis = rng.uniform(0, 2 * math.pi)
    about, back = np.eye(3), np.eye(3)
    about[:2, :2] = rotation(axis)
    back[:2, :2] = rotation(turned - axis)
    lean = np.array(
        [(1, 0, 0), (0, math.cos(tilt), -math.sin(tilt)), (0, math.sin(tilt), math.cos(tilt))]
    )
    turn = about @ lean @ back
    focal = FOCAL * WIDTH
    at = rng.uniform((0, 0), (WIDTH, HEIGHT)) - (WIDTH / 2, HEIGHT / 2)
    there = np.array([*(at / unit), focal / unit])
    camera = np.array([(focal, 0, WIDTH / 2), (0, focal, HEIGHT / 2), (0, 0, 1)])
    return camera @ np.column_stack([turn[:, 0], turn[:, 1], there])


def rotation(angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([(cos, -sin), (sin, cos)])


def through(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    seen = np.column_stack([points, np.ones(len(points))]) @ pose.T
    return seen[:, :2] / seen[:, 2:]


def fill(canvas: np.ndarray, corners: Corners, shade: float) -> None:
    """Fills a polygon given in pixels of the frame; the middle of the first pixel is (0, 0)."""
    finer = (corners + 0.5) * FINER - 0.5
    fixed = np.round(finer * 2**SUBPIXEL).astype(np.int32)
    cv2.fillPoly(canvas, [fixed], 255 * shade, cv2.LINE_AA, SUBPIXEL)


def photograph(rng: np.random.Generator, canvas: np.ndarray, conditions: Conditions) -> np.ndarray:
    scene = cv2.resize(canvas, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32)
    glare = rng.uniform(*conditions.glare)
    direction = rng.uniform(0, 2 * math.pi)
    x, y = np.meshgrid(
        np.linspace(-1, 1, WIDTH, dtype=np.float32), np.linspace(-1, 1, HEIGHT, dtype=np.float32)
    )
    across = (x * math.cos(direction) + y * math.sin(direction)) / math.sqrt(2)
    spot = rng.uniform(-1, 1, 2).astype(np.float32)
    shine = np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / 0.3)
    level = rng.uniform(*conditions.light)
    seen = level * (scene * (1 - glare * (1 + across) / 2) + 255 * glare * shine / 2)
    if (blur := rng.uniform(*conditions.blur)) > 0.1:
        seen = cv2.GaussianBlur(seen, (0, 0), blur)
    seen += np.float32(rng.uniform(*conditions.noise)) * rng.standard_normal(seen.shape, np.float32)
    return np.clip(np.round(seen), 0, 255).astype(np.uint8)


# Objects of the room.


def room(rng: np.random.Generator, things: int) -> np.ndarray:
    """A wall with a coarse texture, or one of tiles, and pieces of clutter."""
    size = FINER * WIDTH, FINER * HEIGHT
    grain = int(2 ** rng.uniform(2, 7))
    coarse = rng.uniform(-1, 1, (grain * 3 // 4, grain)).astype(np.float32)
    wall = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    wall = 255 * rng.uniform(0.2, 0.85) + 255 * rng.uniform(0, 0.2) * wall
    canvas = np.clip(wall, 0, 255).astype(np.uint8)
    if rng.random() < 0.3:
        side, thick = int(rng.uniform(30, 250)), int(rng.uniform(2, 30))
        shade, slant = 255 * rng.random(), rng.uniform(-0.5, 0.5)
        for k in range(-20, 60):
            at = k * side
            ends = [
                ((at, 0), (at + slant * size[1], size[1])),
                ((0, at), (size[0], at - slant * size[0])),
            ]
            for start, end in ends:
                start, end = (tuple(int(v) for v in p) for p in (start, end))
                cv2.line(canvas, start, end, shade, thick, cv2.LINE_AA)
    for _ in range(things):
        clutter(rng, canvas)
    return canvas


def clutter(rng: np.random.Generator, canvas: np.ndarray) -> None:
    """Draws a polygon, an ellipse, lines, a chessboard, or text."""
    at = rng.uniform((0, 0), (FINER * WIDTH, FINER * HEIGHT))
    size = FINER * 10 * 20 ** rng.random()
    shade = 255 * rng.random()
    kind = rng.integers(6)
    if kind == 0:
        corners = at + size * rng.uniform(-1, 1, (rng.integers(3, 13), 2))
        cv2.fillPoly(canvas, [corners.astype(np.int32)], shade, cv2.LINE_AA)
    elif kind == 1:
        axes = tuple(int(v) for v in rng.uniform(3, size, 2))
        thick = int(rng.choice([-1, 2, 6, 12]))
        middle = tuple(int(v) for v in at)
        cv2.ellipse(canvas, middle, axes, 360 * rng.random(), 0, 360, shade, thick, cv2.LINE_AA)
    elif kind == 2:
        for _ in range(3):
            end = at + size * rng.uniform(-2, 2, 2)
            start, stop = (tuple(int(v) for v in p) for p in (at, end))
            cv2.line(canvas, start, stop, shade, int(rng.uniform(1, 30)), cv2.LINE_AA)
    elif kind == 3:
        pose = plane(rng, size / 20, rng.uniform(0, 7), rng.uniform(0, 0.8))
        for row, column in np.ndindex(4, 4):
            square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) - 2
            corners = through(pose, 4 * (square + np.array([column, row])))
            fill(canvas, corners, PAPER if (row + column) % 2 else INK)
    else:
        letters = "".join(rng.choice(list("XXxTH#*FKYtI%&AMWZ"), rng.integers(1, 8)))
        font = int(rng.choice([0, 2, 3, 4, 6]))
        thick = int(rng.integers(1, 14))
        corner = int(at[0] - size), int(at[1])
        if rng.random() < 0.7:
            ends = (at[0] - 1.3 * size, at[1] - size), (at[0] + 2 * size, at[1] + 0.5 * size)
            start, stop = (tuple(int(v) for v in p) for p in ends)
            cv2.rectangle(canvas, start, stop, 255 * rng.uniform(0.6, 1), -1)
            shade *= 0.4
        cv2.putText(canvas, letters, corner, font, size / 30, shade, thick, cv2.LINE_AA)


# Signs that are not the marker, on a sheet as large. Each gives polygons and their shades.

Sign = list[tuple[Corners, float]]


def star(points: int, inner: float) -> Corners:
    angle = math.pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2, inner, 3.0)
    return np.column_stack([radius * np.sin(angle), -radius * np.cos(angle)])


def _arms(count: int) -> Sign:
    bar = np.array([(-0.8, 0), (0.8, 0), (0.8, 3), (-0.8, 3)])
    return [(bar @ rotation(2 * math.pi * k / count).T, INK) for k in range(count)]


SIGNS: dict[str, Callable[[np.random.Generator], Sign]] = {
    "thin plus": lambda rng: [(plus(rng.uniform(0.15, 0.5)), INK)],
    "fat plus": lambda rng: [(plus(rng.uniform(1.7, 2.4)), INK)],
    "Latin cross": lambda rng: [(plus(0.8, (2, rng.uniform(3.8, 4.8), 2, 2)), INK)],
    "T": lambda rng: [(plus(1, (3, 3, 3, 1)), INK)],
    "square": lambda rng: [(rng.uniform(1.5, 3) * SHEET / 5, INK)],
    "disc": lambda rng: [(rng.uniform(1, 3) * star(40, 3) / 3, INK)],
    "star": lambda rng: [(star(int(rng.integers(3, 9)), rng.uniform(0.9, 2)), INK)],
    "other arms": lambda rng: _arms(int(rng.choice([3, 5, 6, 8]))),
    "white on black": lambda rng: [(SHEET, INK), (CROSS, PAPER)],
    "outline": lambda rng: [(plus(1.15, (3.15,) * 4), INK), (plus(0.85, (2.85,) * 4), PAPER)],
    "bent arms": lambda rng: [
        (plus(1), INK),
        *(
            (np.array([(3, -1), (3, 1), (1.5, 3), (1, 1)]) @ rotation(k * math.pi / 2).T, INK)
            for k in range(4)
        ),
    ],
    "letter X": lambda rng: [
        (np.array([(-s - 0.8, -3), (-s + 0.8, -3), (s + 0.8, 3), (s - 0.8, 3)]), INK)
        for s in (rng.uniform(1.2, 1.6) * np.array([1, -1]))
    ],
    "twelve corners": lambda rng: [(_ragged(rng), INK)],
}


def _ragged(rng: np.random.Generator) -> Corners:
    angle = 2 * math.pi * (np.arange(12) + rng.uniform(-0.3, 0.3, 12)) / 12
    radius = rng.uniform(1, 3, 12)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
