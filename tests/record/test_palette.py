import itertools

import numpy as np
import pytest

from jaxcell.record.canvas import palette
from jaxcell.record.canvas.palette import CATEGORIES, GROUP_CLASSES, cycle_color, group_class, ramp


# Machado, Oliveira and Fernandes (2009), severity 1.
PROTANOPIA = """
 0.152286  1.052583 -0.204868
 0.114503  0.786281  0.099216
-0.003882 -0.048116  1.051998"""
DEUTERANOPIA = """
 0.367322  0.860646 -0.227968
 0.280085  0.672501  0.047413
-0.011820  0.042940  0.968881"""
SIGHT = {
    "normal": np.eye(3),
    "protanopia": np.array(PROTANOPIA.split(), float).reshape(3, 3),
    "deuteranopia": np.array(DEUTERANOPIA.split(), float).reshape(3, 3),
}


def lab(color, sight):
    """CIE L*a*b* of an sRGB colour, as it is seen."""
    rgb = np.asarray(color) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(SIGHT[sight] @ linear, 0, 1)
    to_xyz = [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
    x, y, z = np.cbrt(np.maximum((to_xyz @ linear) / [0.95047, 1, 1.08883], 0.008856))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def distance(first, second, sight):
    return np.linalg.norm(lab(first, sight) - lab(second, sight))


@pytest.mark.parametrize("sight", SIGHT)
def test_colors_on_a_map_differ(sight):
    things = ["OBSTACLE", "FREE", "MARGIN", "ROBOT", "BELIEF", "KNOWN"]
    for one, other in itertools.combinations(things, 2):
        seen = distance(getattr(palette, one), getattr(palette, other), sight)
        assert seen > 15, (one, other)
    for color in CATEGORIES.values():
        assert distance(color, palette.OBSTACLE, sight) > 25
    for one, other in itertools.combinations(CATEGORIES, 2):
        assert distance(CATEGORIES[one], CATEGORIES[other], sight) > 10, (one, other)


@pytest.mark.parametrize("sight", SIGHT)
def test_the_state_of_a_filter_differs_from_others_in_both_themes(sight):
    """Graphs have the background of the viewer, and lines in its colour of text."""
    white, black = (255, 255, 255), (13, 16, 17)
    others = [white, black, palette.PLAIN, palette.ROBOT, *CATEGORIES.values()]
    for other in others:
        assert distance(palette.CURRENT, other, sight) > 10, other
    # Earlier states have the colour of the robot.
    for theme, (color, least) in itertools.product(
        (white, black), ((palette.CURRENT, 35), (palette.ROBOT, 25))
    ):
        assert abs(lightness(color, sight) - lightness(theme, sight)) > least


@pytest.mark.parametrize("sight", SIGHT)
def test_the_ramp_gets_lighter(sight):
    lightness = [lab(color, sight)[0] for color in ramp(np.linspace(0, 1, 33))]
    assert (np.diff(lightness) > 0).all()


def lightness(color, sight="normal"):
    return lab(color[:3], sight)[0]


GROUNDS = [
    palette.BLACK,
    palette.FREE,
    palette.PLAIN,
    palette.OBSTACLE,
    *CATEGORIES.values(),
    *(palette.tint(color, 0.6) for color in CATEGORIES.values()),
    *(tuple(color) for color in ramp(np.linspace(0, 1, 9)).tolist()),
]


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("veil", [22, 112], ids=["dark", "light"])
def test_labels_are_legible_in_both_themes(ground, veil):
    """The viewer lays half of its own ground under a label; measured on its screenshots."""
    behind = np.asarray(ground) / 2 + veil
    label, other = palette.text_on(ground), {palette.INK, palette.TEXT} - {palette.text_on(ground)}
    assert abs(lightness(label) - lightness(behind)) > 25
    # The other one would be worse in one of the themes.
    worst = [
        min(abs(lightness(one) - lightness(np.asarray(ground) / 2 + each)) for each in (22, 112))
        for one in (label, *other)
    ]
    assert worst[0] >= worst[1] - 10


def test_classes_of_groups():
    ranks = np.arange(30)
    classes = group_class(ranks)
    assert (classes < len(GROUP_CLASSES)).all()
    names = [GROUP_CLASSES[one].label for one in classes]
    cycles = [GROUP_CLASSES[one + 1] for one in classes]
    assert names[:2] == ["leads to the largest group", "leads to the group of rank 2"]
    assert len(set(names)) == 8
    assert set(names[7:]) == {"leads to a smaller group"}
    for name, cycle in zip(names, cycles, strict=True):
        assert cycle.label == name.replace("leads to", "on")
    # Neighbours in rank differ even where there are many, and no two of the first seven are alike.
    colors = [GROUP_CLASSES[one].color for one in classes]
    assert all(one != other for one, other in itertools.pairwise(colors))
    assert len(set(colors[:7])) == 7


def test_colors_of_cycles():
    names = [cycle_color(c)[0] for c in (2, 3, 8, 9)]
    assert names == ["orange", "sky blue", "pink", "dark orange"]


@pytest.mark.parametrize(
    "colors",
    [
        [color for _, color in palette.ROBOTS],
        palette.RANKED,
        [palette.angle_color(number) for number in range(18)],
        [cycle_color(number)[1] for number in range(2, 23)],
    ],
)
def test_colors_can_be_told_apart(colors):
    assert len(colors) >= 14
    assert min(distance(*pair, "normal") for pair in itertools.combinations(colors, 2)) > 10


def test_robots_that_share_a_color_are_named_together():
    assert palette.robots_by_color(5)[0] == ("0", *palette.ROBOTS[0])
    count = len(palette.ROBOTS)
    alike = palette.robots_by_color(count + 2)
    assert len(alike) == count
    assert alike[1] == (f"1, {count + 1}", *palette.ROBOTS[1])
    assert palette.robot_color(1) == palette.robot_color(count + 1)
