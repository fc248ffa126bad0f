"""The colours of all recordings, which colour-blind people can distinguish too.

What stands for one thing is the same everywhere: obstacles are dark, free space is light, the
robot is vermilion, where it may be is blue, and what is known in the end is green. A way goes from
the blue start to the green goal, and what an adversary attacks is pink.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int, Num, UInt8


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

# Okabe and Ito's, without black.
CATEGORIES: dict[str, Color] = {
    "orange": (230, 159, 0),
    "sky blue": (86, 180, 233),
    "green": (0, 158, 115),
    "yellow": (240, 228, 66),
    "blue": (0, 114, 178),
    "vermilion": (213, 94, 0),
    "pink": (204, 121, 167),
}

_ROBOTS = ("vermilion", "blue", "green", "orange", "pink", "sky blue", "yellow")
ROBOTS: list[tuple[str, Color]] = [*((name, CATEGORIES[name]) for name in _ROBOTS), ("grey", PLAIN)]
"""The first robot, the second, and so on."""

# Samples of viridis, without its darkest part, which obstacles would be taken for.
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


# Grounds that are darker than this have white labels.
_DARK = 104
# What a solver leaves of a probability that is 0.
_NOTHING = 1e-9


def robot_color(robot: int) -> tuple[str, Color]:
    """What stands for one of several robots, which are counted from 0."""
    return ROBOTS[robot % len(ROBOTS)]


def ramp(value: Float[np.ndarray, "values"]) -> UInt8[np.ndarray, "values 3"]:
    """Colours for numbers from 0 (dark blue) to 1 (yellow)."""
    at = np.clip(value, 0, 1) * (len(_RAMP) - 1)
    channels = [np.interp(at, np.arange(len(_RAMP)), channel) for channel in _RAMP.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def share_colors(share: Float[np.ndarray, "values"], none: Color) -> UInt8[np.ndarray, "values 3"]:
    """The colours of [`ramp`][], and another for what is 0."""
    return np.where(share[:, None] > _NOTHING, ramp(share), none[:3]).astype(np.uint8)


def text_on(ground: Color) -> Color:
    """The colour of a label on a ground, which is legible in both themes of the viewer.

    Behind a label there is half a veil, dark in the dark theme and light in the light one.
    """
    red, green, blue = ground[:3]
    return INK if 0.3 * red + 0.59 * green + 0.11 * blue > _DARK else TEXT


def mix(color: Color, other: Color, share: float) -> Color:
    """A colour with a share of another."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(color, other, strict=True))
    return red, green, blue


def tint(color: Color, share: float) -> Color:
    """A colour with a share of that of free space."""
    return mix(color, FREE, share)


class PictureClass(NamedTuple):
    """What squares of one class in a picture have in common: an entry of a legend."""

    label: str
    color: Color


class Level(NamedTuple):
    """An entry of a legend that is part of a colour bar with those beside it."""

    label: str
    color: Color


NOT_FREE = PictureClass("not free", CLEAR)
"""The first class of a picture of a map."""


def cycle_color(color: int) -> tuple[str, Color]:
    """What stands for a knowledge cycle, by the colour that its filter gives it (2, 3, ...)."""
    named = list(CATEGORIES.items())
    return named[(color - 2) % len(named)]


def _group_classes() -> list[PictureClass]:
    classes = [NOT_FREE]
    for shade, rest in (0.0, ""), (0.6, "a smaller group"):
        for place, color in enumerate(CATEGORIES.values()):
            label = rest or ("the largest group", f"the group of rank {place + 1}")[place > 0]
            color = mix(color, (255, 255, 255), shade)
            classes.append(PictureClass(f"leads to {label}", color))
            classes.append(PictureClass(f"on {label}", mix(color, (0, 0, 0), 0.35)))
    return classes


GROUP_CLASSES = _group_classes()
"""The classes in pictures of groups: what is not free, then for each rank the cells that lead to
the group and the cells on it, which are darker. The groups past the colours are pale."""


def ranks(sizes: Num[np.ndarray, "groups"]) -> Int[np.ndarray, "groups"]:
    """The rank of each size, 0 for the largest; equal ones in their order."""
    rank = np.empty(sizes.size, np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(sizes.size)
    return rank


def group_class(rank: Int[np.ndarray, "groups"]) -> UInt8[np.ndarray, "groups"]:
    """The class of the cells that lead to groups, from the ranks of their basins; the next class is
    that of the cells on them.
    """
    count = len(CATEGORIES)
    place = np.where(rank < count, rank, count + rank % count)
    return (1 + 2 * place).astype(np.uint8)
