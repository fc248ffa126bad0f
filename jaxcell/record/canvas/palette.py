"""The colours of all recordings. Colour-blind people can distinguish them too.

A colour has one meaning everywhere: obstacles are dark, free space is light, the robot is
vermilion, its possible cells are blue, and those that are left at the end are green. A path goes
from the blue start to the green goal, and the target of an adversary is pink.
"""

from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int, UInt8


Color: TypeAlias = tuple[int, int, int] | tuple[int, int, int, int]

BLACK: Color = (0, 0, 0)
OBSTACLE: Color = (52, 54, 58)
CLEAR: Color = (0, 0, 0, 0)
FREE: Color = (236, 236, 232)
MARGIN: Color = (96, 100, 106)
WALL: Color = (205, 208, 212)
TEXT: Color = (255, 255, 255)
INK: Color = (0, 0, 0)
ROBOT: Color = (213, 94, 0)
TRAIL: Color = (90, 90, 90)
BELIEF: Color = (0, 114, 178)
KNOWN: Color = (0, 158, 115)
START: Color = BELIEF
GOAL: Color = KNOWN
TARGET: Color = (204, 121, 167)
PLAIN: Color = (140, 144, 150)
CURRENT: Color = (120, 94, 240)
ON_GROUP: Color = (255, 255, 255)

# The colours of Okabe and Ito, without black.
CATEGORIES: dict[str, Color] = {
    "orange": (230, 159, 0),
    "sky blue": (86, 180, 233),
    "green": (0, 158, 115),
    "yellow": (240, 228, 66),
    "blue": (0, 114, 178),
    "vermilion": (213, 94, 0),
    "pink": (204, 121, 167),
}

# Samples of the colour map viridis, without its darkest part, which looks like an obstacle.
_RAMP = np.array(
    [
        (62, 73, 137),
        (49, 104, 142),
        (38, 130, 142),
        (31, 158, 137),
        (53, 183, 121),
        (110, 206, 88),
        (181, 222, 43),
        (253, 231, 37),
    ],
    float,
)


# Labels on grounds darker than this are white.
_DARK = 104
# Probabilities up to this count as 0, because solvers are not exact.
_NOTHING = 1e-9


def ramp(value: Float[np.ndarray, "values"]) -> UInt8[np.ndarray, "values 3"]:
    """Return colours for numbers from 0 (dark blue) to 1 (yellow)."""
    at = np.clip(value, 0, 1) * (len(_RAMP) - 1)
    channels = [np.interp(at, np.arange(len(_RAMP)), channel) for channel in _RAMP.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def share_colors(share: Float[np.ndarray, "values"], none: Color) -> UInt8[np.ndarray, "values 3"]:
    """Return the colours of [`ramp`][] for positive numbers, and the colour `none` for 0."""
    return np.where(share[:, None] > _NOTHING, ramp(share), none[:3]).astype(np.uint8)


def text_on(ground: Color) -> Color:
    """Choose black or white for a label, so that it is legible in both themes of the viewer.

    Behind a label the viewer draws a half-transparent box, which is dark in the dark theme and
    light in the light theme. `ground` is the colour of the picture under this box.
    """
    red, green, blue = ground[:3]
    return INK if 0.3 * red + 0.59 * green + 0.11 * blue > _DARK else TEXT


def mix(color: Color, other: Color, share: float) -> Color:
    """Mix two colours; `share` is the fraction of the second colour, from 0 to 1."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(color, other, strict=True))
    return red, green, blue


def tint(color: Color, share: float) -> Color:
    """Mix a colour with the colour of free space; `share` is the fraction of the latter."""
    return mix(color, FREE, share)


class PictureClass(NamedTuple):
    """The label and the colour of a class in a picture; also an entry of a legend."""

    label: str
    color: Color


class Level(NamedTuple):
    """An entry of a legend for a level of a scale; adjacent levels form a colour bar."""

    label: str
    color: Color


NOT_FREE = PictureClass("not free", CLEAR)
"""Class 0 in pictures of a map: squares that are not free."""


def shades(names: Iterable[str] = CATEGORIES) -> list[tuple[str, Color]]:
    """Return names and colours: first the categories `names`, then dark ones, then pale ones."""
    toward: list[tuple[str, Color, float]] = [
        ("", (0, 0, 0), 0.0),
        ("dark ", (0, 0, 0), 0.45),
        ("pale ", (255, 255, 255), 0.6),
    ]
    names = list(names)
    return [
        (f"{shade}{name}", mix(CATEGORIES[name], other, share))
        for shade, other, share in toward
        for name in names
    ]


ROBOTS = shades(("vermilion", "blue", "green", "orange", "pink", "sky blue", "yellow"))
"""The name and the colour of each robot, by its number. Later robots have the colours again."""
# The first angles avoid the colours of the robot and of the start; all avoid that of the goal.
_ANGLES = shades(("orange", "sky blue", "pink", "yellow", "blue", "vermilion"))
_CYCLES = shades()


def robot_color(robot: int) -> tuple[str, Color]:
    """Return the name and the colour of a robot; robots are counted from 0."""
    return ROBOTS[robot % len(ROBOTS)]


def robots_by_color(robots: int) -> list[tuple[str, str, Color]]:
    """List each colour of robots: its robots, such as "0, 21", its name, and the colour."""
    return [
        (", ".join(map(str, range(first, robots, len(ROBOTS)))), name, color)
        for first, (name, color) in enumerate(ROBOTS[:robots])
    ]


def angle_color(number: int) -> Color:
    """Return the colour of a bouncing angle; angles are counted from 0."""
    return _ANGLES[number % len(_ANGLES)][1]


def cycle_color(number: int) -> tuple[str, Color]:
    """Return the name and the colour of a cycle, from its number in `Filter.color`, at least 2."""
    return _CYCLES[(number - 2) % len(_CYCLES)]


RANKED: list[Color] = [
    mix(color, (255, 255, 255), pale) for pale in (0.0, 0.6) for color in CATEGORIES.values()
]
"""Colours of groups by rank: strong colours for the largest groups, pale ones for the others."""


def _group_classes() -> list[PictureClass]:
    classes = [NOT_FREE]
    for place, color in enumerate(RANKED):
        label = f"the group of rank {place + 1}" if place else "the largest group"
        label = label if place < len(CATEGORIES) else "a smaller group"
        classes.append(PictureClass(f"leads to {label}", color))
        classes.append(PictureClass(f"on {label}", mix(color, (0, 0, 0), 0.35)))
    return classes


GROUP_CLASSES = _group_classes()
"""The classes in pictures of groups. Class 0 means squares that are not free. Then each colour of
[`RANKED`][] has two classes: the first for cells that lead to a group, and the next, which is
darker, for cells of the group itself."""


def ranked(rank: Int[np.ndarray, "groups"]) -> Int[np.ndarray, "groups"]:
    """Return the index of the colour of each group in [`RANKED`][], from the rank of the group."""
    count = len(CATEGORIES)
    return np.where(rank < count, rank, count + rank % count)


def group_class(rank: Int[np.ndarray, "groups"]) -> UInt8[np.ndarray, "groups"]:
    """Return the class in [`GROUP_CLASSES`][] for cells that lead to each group, from its rank."""
    return (1 + 2 * ranked(rank)).astype(np.uint8)
