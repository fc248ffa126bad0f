"""Choose a bouncing angle at each bump so that a robot is localized after few bumps."""

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from .boundary import bump_gains, run_to_wall
from .filter import WallFilter
from .sets import WallSet


# The largest number of stretches of a set that a trial follows. Larger sets are sampled.
_FOLLOWED = 96
# The length in metres that is added to each stretch of a set, because a stretch may be a point.
_POINT = 0.05
# A turn is of use if the size of a set is expected to become less than this part of it.
_OF_USE = 0.95
# The largest number of trials that are computed together.
_AT_ONCE = 20_000

Aim: TypeAlias = Literal["worst", "mean"]
"""The criterion of a choice: the largest or the mean size of a set after the next bumps."""


def choose_angles(
    filter: WallFilter,
    state: WallSet,
    robots: int,
    angles: Sequence[float],
    rng: np.random.Generator,
    *,
    aim: Aim = "mean",
    ahead: int = 1,
    draws: int = 6,
) -> Int[np.ndarray, "robots"]:
    """Choose the angle after which the set of possible places of each robot is smallest.

    `draws` places are drawn from the set of each robot. For each angle, the set is updated with the
    run from each of these places to the next bump, and so on for `ahead` bumps. The chosen angle
    minimizes the mean of the resulting sizes or, if `aim` is `"worst"`, the largest of them. If no
    angle is expected to make the set smaller, it is drawn at random, because the robot would repeat
    the best angle without end.

    `state` contains the sets after a bump and before the turn. `angles` are in radians. Returns the
    index of each robot's angle.

    The size of a set is the diagonal of its bounding box times the length of all its stretches. The
    diagonal alone does not change while a set is spread over the room, and the length alone does
    not favour places that are near each other.
    """
    chosen = np.zeros(robots, np.int32)
    if len(angles) == 1:
        return chosen
    size = max(1, _AT_ONCE // (draws * len(angles)) ** ahead)
    for first in range(0, robots, size):
        part = state.take((state.robot >= first) & (state.robot < first + size))
        part = part._replace(robot=part.robot - first)
        count = min(size, robots - first)
        if not part.robot.size:
            chosen[first : first + count] = rng.integers(len(angles), size=count)
            continue
        sizes = _expected_sizes(filter, part, count, angles, rng, aim, ahead, draws)
        of_use = sizes.min(axis=0) < _OF_USE * _sizes(filter, part, count)
        drawn = rng.integers(len(angles), size=count)
        chosen[first : first + count] = np.where(of_use, np.argmin(sizes, axis=0), drawn)
    return chosen


def _expected_sizes(
    filter: WallFilter,
    state: WallSet,
    robots: int,
    angles: Sequence[float],
    rng: np.random.Generator,
    aim: Aim,
    ahead: int,
    draws: int,
) -> Float[np.ndarray, "angles robots"]:
    """Estimate the size of the set of each robot after a turn by each angle, in square metres.

    All angles are tried from the same random places, so that only the angles make a difference.
    """
    trials = robots * draws
    place, heading, wall = draw_places(filter, state, robots, draws, rng)
    heading = heading + bump_gains(filter.boundary, wall, heading, filter.errors.bump_turn)[0]
    copies = _sampled(state, robots, rng)
    each = np.repeat(np.arange(draws), copies.robot.size)
    copies = WallSet(*(np.tile(part, draws) for part in copies))
    copies = copies._replace(robot=copies.robot * draws + each)
    sizes = []
    for angle in angles:
        _, _, run = run_to_wall(filter.boundary, place, heading + angle)
        after = filter.observe(filter.turn(copies, angle), run)
        if ahead == 1:
            sizes.append(_sizes(filter, after, trials))
        else:
            later = _expected_sizes(filter, after, trials, angles, rng, aim, ahead - 1, draws)
            sizes.append(later.min(axis=0))
    by_draw = np.reshape(sizes, (len(angles), robots, draws))
    return by_draw.max(axis=2) if aim == "worst" else by_draw.mean(axis=2)


def _sizes(filter: WallFilter, state: WallSet, robots: int) -> Float[np.ndarray, "robots"]:
    """Compute the size of the set of each robot, in square metres; that of an empty set is 0."""
    length = np.bincount(state.robot, state.end - state.begin + _POINT, robots)
    # The sample of a large set may lack the stretch of a trial, and become empty.
    return length * np.where(length > 0, filter.extent(state, robots), 0.0)


def draw_places(
    filter: WallFilter, state: WallSet, robots: int, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "draws 2"], Float[np.ndarray, "draws"], Int[np.ndarray, "draws"]]:
    """Draw `count` places in metres and headings in radians from the set of each robot.

    The third result is the wall of each place. The places of an empty set have no meaning.
    """
    robot = np.repeat(np.arange(robots), count)
    number = np.bincount(state.robot, minlength=robots)
    weight = np.cumsum(state.end - state.begin + 1e-3)
    bounds = np.r_[0.0, weight][np.r_[0, np.cumsum(number)]]
    drawn = bounds[robot] + rng.uniform(size=robot.size) * (bounds[robot + 1] - bounds[robot])
    if not weight.size:
        return np.zeros((robot.size, 2)), np.zeros(robot.size), np.zeros(robot.size, int)
    stretch = np.minimum(np.searchsorted(weight, drawn, side="right"), weight.size - 1)
    begin, end = state.begin[stretch], state.end[stretch]
    arc = begin + rng.uniform(size=robot.size) * (end - begin)
    within = rng.uniform(size=robot.size) if filter.chords.width else 0.0
    heading = (state.slice[stretch] + within) * 2 * np.pi / filter.chords.slices
    wall = state.wall[stretch]
    return filter.boundary.point(wall, arc), heading, wall


def _sampled(state: WallSet, robots: int, rng: np.random.Generator) -> WallSet:
    """Reduce the set of each robot to a random sample of at most `_FOLLOWED` stretches."""
    number = np.bincount(state.robot, minlength=robots)
    if number.max(initial=0) <= _FOLLOWED:
        return state
    order = np.argsort(state.robot + rng.uniform(size=state.robot.size))
    rank = np.arange(order.size) - (np.cumsum(number) - number)[state.robot[order]]
    return state.take(np.sort(order[rank < _FOLLOWED]))
