"""Propose the bouncing angles with which robots that start anywhere are soon localized, or home."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from ..space import Workspace
from .filter import WallFilter, bumps_until_localized
from .homing import Homing
from .trial import drive_anywhere


def propose_angles(
    workspace: Workspace,
    filter: WallFilter,
    angles: Sequence[float],
    *,
    most: int,
    radius: float,
    goal: tuple[tuple[float, float], float] | None = None,
    headings: int | None = None,
    robots: int = 12,
    bumps: int = 10,
    kept: int = 2,
    seed: int = 0,
    say: Callable[..., None] = lambda doing, done=0, total=0: None,
) -> tuple[tuple[tuple[float, ...], ...], int]:
    """Propose the best 1, 2, ..., `most` bouncing angles of a robot that starts anywhere.

    All single angles are tried, and then each of the best `kept` sets with each further angle. The
    same simulated robots try all sets. The score of a set is the mean number of bumps until the
    robots are localized, where robots that are not localized count twice `bumps`. If there is a
    goal, the mean number of bumps from a known place to the goal is added. The search does not
    try all sets, and a dozen robots do not tell good sets apart.

    **Arguments:**

    - `filter`: the filter of the robots. A filter with few slices makes the search faster.
    - `angles`: the angles to choose from, in radians.
    - `radius`: the distance in metres within which a robot is localized.
    - `goal`: the centre and the radius of the goal region in metres, or `None`.
    - `headings`, `say`: as for [`drive_anywhere`][jaxcell.walls.drive_anywhere].

    **Returns:** for each number of angles the best set, and the number of sets that were tried.

    In a room with a niche, a robot that turns by 90 degrees at each bump is never localized:

        >>> import math
        >>> from jaxcell import space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> filter = walls.WallFilter.of(room, headings=8, errors=walls.Errors(distance=0.01))
        >>> angles = [math.radians(angle) for angle in (90, 135)]
        >>> best, tried = walls.propose_angles(
        ...     room, filter, angles, most=1, radius=0.1, headings=8
        ... )
        >>> [round(math.degrees(angle)) for angle in best[0]], tried
        ([135], 2)
    """
    scores: dict[tuple[float, ...], float] = {}
    homing = None if goal is None else Homing(filter, *goal, tuple(angles))

    def score(several: tuple[float, ...]) -> float:
        trial = drive_anywhere(
            workspace, filter, several, robots=robots, bumps=bumps, headings=headings, seed=seed
        )
        known = bumps_until_localized(trial.extent, radius)
        value = float(np.where(np.isfinite(known), known, 2 * bumps).mean())
        return value if homing is None else value + float(homing.bumps_by(several).mean())

    best: list[list[tuple[float, ...]]] = []
    for size in range(1, min(most, len(angles)) + 1):
        before = best[-1] if best else [()]
        tried = {tuple(sorted({*one, angle})) for one, angle in itertools.product(before, angles)}
        several = sorted(one for one in tried if len(one) == size)
        for done, one in enumerate(several):
            say(f"trying {len(several)} sets of angles", done, len(several))
            scores[one] = score(one)
        best.append(sorted(several, key=scores.__getitem__)[:kept])
    return tuple(of_size[0] for of_size in best), len(scores)
