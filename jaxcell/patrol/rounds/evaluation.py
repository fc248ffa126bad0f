import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .game import Game
from .route import Route


# Rounding error of a time, relative, by which an attack does not become longer.
_ROUNDING = 1e-9
# Largest denominator of a ratio of periods, and largest number of periods in a common one.
_RATIO, _REPEATS = 64, 10_000


class Evaluation(NamedTuple):
    """The times between visits to targets, and the attacks that succeed."""

    longest: Float[np.ndarray, "targets"]
    "The longest time between visits of any robot; infinite if there are none."
    exposure: Float[np.ndarray, "targets"]
    "The share of moments at which an attack succeeds that begins then."
    every: Float[np.ndarray, "targets"]
    "The time after which visits repeat; infinite if there are none, or robots meet in all phases."

    def risk(self, game: Game) -> Float[np.ndarray, "targets"]:
        """Return the loss from an attack on each target, by the adversary of the game."""
        if game.adversary == "blind":
            return self.exposure * game.value
        return np.where(self.longest > game.attack * (1 + _ROUNDING), game.value, 0.0)


def evaluate(game: Game, routes: Sequence[Route]) -> Evaluation:
    """Compute the times between visits to each target, and its exposure, exactly.

    Robots whose periods have a common multiple keep a shared clock; others meet in all phases.
    **Raises:** `ValueError` if there are more routes than robots, or a route cannot be followed.

    Two robots half a round apart on a line of three vertices, where attacks take 1 step:

        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2]])
        >>> game = patrol.rounds.Game.of(line, 1.0, robots=2)
        >>> found = patrol.rounds.evaluate(game, patrol.rounds.best_rounds(game).routes)
        >>> found.longest.tolist(), found.exposure.tolist()
        ([2.0, 2.0, 2.0], [0.5, 0.5, 0.5])
    """
    if not 0 < len(routes) <= game.robots:
        raise ValueError(f"routes: expected 1 to {game.robots}, one per robot, got {len(routes)}")
    for number, route in enumerate(routes):
        route.check(game, f"routes[{number}]")
    return evaluate_followed(game, routes)


def evaluate_followed(game: Game, routes: Sequence[Route]) -> Evaluation:
    """Evaluate routes that robots can follow, as [`evaluate`][] does, without checks."""
    rows = []
    for target, attack in zip(game.targets.tolist(), game.attack.tolist(), strict=True):
        longest, exposed, every = math.inf, 1.0, math.inf
        for period, gaps in (groups := _groups(routes, target)):
            late = gaps[gaps > attack * (1 + _ROUNDING)] - attack
            exposed *= late.sum() / period
            longest = min(longest, float(gaps.max()))
            even = math.isclose(gaps.max() * gaps.size, period)
            every = math.inf if len(groups) > 1 else period / (gaps.size if even else 1)
        rows.append((longest, exposed, every))
    return Evaluation(*np.array(rows).T)


def _groups(routes: Sequence[Route], target: int) -> list[tuple[float, Float[np.ndarray, "_"]]]:
    """Return the period and the times between visits of each group of robots with a clock."""
    groups: list[list[tuple[Fraction, Route]]] = []
    for route in routes:
        if not (route.vertex == target).any():
            continue
        for group in groups:
            ratio = route.period / group[0][1].period
            exact = Fraction(ratio).limit_denominator(_RATIO)
            if not exact or abs(ratio / float(exact) - 1) > _ROUNDING:
                continue
            if _common([*group, (exact, route)]) < _REPEATS * min(exact, Fraction(1)):
                group.append((exact, route))
                break
        else:
            groups.append([(Fraction(1), route)])
    found = []
    for group in groups:
        hyper = _common(group)
        period, arrive, leave = group[0][1].period * float(hyper), [], []
        for relative, route in group:
            at, repeats = route.vertex == target, int(hyper / relative)
            begins = np.arange(repeats) * (period / repeats)
            arrive.append((begins[:, None] + route.arrive[at]).ravel())
            leave.append((begins[:, None] + route.leave[at]).ravel())
        found.append((period, _gaps(np.concatenate(arrive), np.concatenate(leave), period)))
    return found


def _common(group: Sequence[tuple[Fraction, Route]]) -> Fraction:
    """Return the least common multiple of periods, relative to the first."""
    ratios = [ratio for ratio, _ in group]
    multiple = math.lcm(*(ratio.numerator for ratio in ratios))
    return Fraction(multiple, math.gcd(*(ratio.denominator for ratio in ratios)))


def _gaps(
    arrive: Float[np.ndarray, "visits"], leave: Float[np.ndarray, "visits"], period: float
) -> Float[np.ndarray, "visits"]:
    """Return the time before each visit in which no robot is there."""
    begins = arrive % period
    order = np.argsort(begins, kind="stable")
    begins, ends = begins[order], (begins + leave - arrive)[order]
    last = np.maximum.accumulate(np.append(ends.max() - period, ends[:-1]))
    return np.maximum(begins - last, 0.0)
