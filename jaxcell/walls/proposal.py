"""Propose the bouncing angles with which robots that start anywhere are soon localized, or home."""

import itertools
import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from ..space import Workspace
from .filter import WallFilter, bumps_until_localized
from .homing import Homing
from .trial import drive_anywhere


# The shares of the robots that try the sets of a size, in each round.
_SHARES = (0.25, 0.5, 1.0)


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
    seconds: float = math.inf,
    say: Callable[..., None] = lambda doing, done=0, total=0: None,
) -> tuple[tuple[tuple[float, ...], ...], int, bool]:
    """Propose the best 1, 2, ..., `most` bouncing angles of a robot that starts anywhere.

    All single angles are tried, and then each of the best `kept` sets with each further angle. The
    sets of a size are tried in three rounds, by a quarter, a half and all of the robots; after a
    round, the better quarter of the sets stays. The same simulated robots try all sets of a round.
    The score of a set is the mean number of bumps until the robots are localized, where robots that
    are not localized count twice `bumps`. If there is a goal, the mean number of bumps from a known
    place to the goal is added. The search does not try all sets, and a dozen robots do not tell
    good sets apart.

    **Arguments:**

    - `filter`: the filter of the robots. A filter with few slices makes the search faster.
    - `angles`: the angles to choose from, in radians.
    - `radius`: the distance in metres within which a robot is localized.
    - `goal`: the centre and the radius of the goal region in metres, or `None`.
    - `seconds`: the time limit of the search.
    - `headings`, `say`: as for [`drive_anywhere`][jaxcell.walls.drive_anywhere].

    **Returns:** for each number of angles the best set, the number of sets that were tried, and
    false if the time was over before the end of the search. Then the largest sets may be missing.

    In a room with a niche, a robot that turns by 90 degrees at each bump is never localized:

        >>> import math
        >>> from jaxcell import space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> filter = walls.WallFilter.of(room, headings=8, errors=walls.Errors(distance=0.01))
        >>> angles = [math.radians(angle) for angle in (90, 135)]
        >>> best, tried, _ = walls.propose_angles(
        ...     room, filter, angles, most=1, radius=0.1, headings=8
        ... )
        >>> [round(math.degrees(angle)) for angle in best[0]], tried
        ([135], 2)
    """
    homing = None if goal is None else Homing(filter, *goal, tuple(angles))
    until = time.monotonic() + seconds
    tried: set[tuple[float, ...]] = set()

    def score(several: tuple[float, ...], robots: int) -> float:
        trial = drive_anywhere(
            workspace, filter, several, robots=robots, bumps=bumps, headings=headings, seed=seed
        )
        known = bumps_until_localized(trial.extent, radius)
        value = float(np.where(np.isfinite(known), known, 2 * bumps).mean())
        return value if homing is None else value + float(homing.bumps_by(several).mean())

    def best_of(several: list[tuple[float, ...]], size: int) -> list[tuple[float, ...]]:
        for number, share in enumerate(_SHARES, 1):
            if share < 1 and len(several) <= kept:
                continue
            scores: dict[tuple[float, ...], float] = {}
            for done, one in enumerate(several):
                say(f"trying sets of {size}, round {number}", done, len(several))
                scores[one] = score(one, math.ceil(share * robots))
                tried.add(one)
                if time.monotonic() > until:
                    return sorted(scores, key=scores.__getitem__)
            several = sorted(several, key=scores.__getitem__)[: max(kept, len(several) // 4)]
        return several[:kept]

    best: list[list[tuple[float, ...]]] = []
    for size in range(1, min(most, len(angles)) + 1):
        before = best[-1] if best else [()]
        grown = {tuple(sorted({*one, angle})) for one, angle in itertools.product(before, angles)}
        best.append(best_of(sorted(one for one in grown if len(one) == size), size))
        if time.monotonic() > until:
            break
    finished = time.monotonic() <= until
    return tuple(of_size[0] for of_size in best), len(tried), finished
