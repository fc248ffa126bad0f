"""Schedules of which one is drawn each night, for an adversary who does not know the draw."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .blind import least_risk
from .evaluation import evaluate_followed
from .game import Game
from .mixing import mixture
from .route import Route
from .search import best_rounds


# Number of longest periods within which a schedule begins.
_PERIODS = 10_000


class DrawnSchedules(NamedTuple):
    """Schedules of all robots, and the probability of each."""

    schedules: tuple[tuple[Route, ...], ...]
    chance: Float[np.ndarray, "schedules"]
    exposure: Float[np.ndarray, "targets"]
    "The probability that an attack on each target succeeds, at any moment."
    risk: float
    "The largest product of exposure and value."
    least: bool = False
    "`True` if no strategy has a smaller risk; otherwise a better one may exist."

    def draw(self, seed: int) -> tuple[Route, ...]:
        """Draw a schedule, which begins at a random moment of it, the same for all robots."""
        random = np.random.default_rng(seed)
        routes = self.schedules[random.choice(self.chance.size, p=self.chance)]
        ahead = random.uniform(0, _PERIODS * max(route.period for route in routes))
        return tuple(_shifted(route, ahead) for route in routes)


def best_mixture(game: Game) -> DrawnSchedules:
    """Search for schedules of which one is drawn each night, with the least risk.

    The adversary may know the schedules and their probabilities, but neither which one is drawn,
    nor the moment at which it begins. The exposure of a target is the mean over schedules, and a
    linear program finds their probabilities. In games with whole times and up to 12,000 moves of
    `least_risk` they are the cycles of the best strategy, so that no strategy has a smaller risk,
    and `least` is `True`. In others, on up to 14 targets with two robots or 11 with four, they are
    the rounds of [`best_routes`][].

    **Arguments:** the game, with the adversary `blind`. **Returns:** `DrawnSchedules`.

    A guard and two vertices that are 3 s apart, where attacks take 1 s: each night at one of them.

        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1]], xy=[[0, 0], [3, 0]])
        >>> drawn = patrol.rounds.best_mixture(patrol.rounds.Game.of(line, 1.0, speed=1.0))
        >>> drawn.chance.round(6).tolist(), sorted(r.vertex.item() for (r,) in drawn.schedules)
        ([0.5, 0.5], [0, 1])
    """
    if game.adversary != "blind":
        raise ValueError(
            "adversary: expected blind, because a watcher sees which schedule is drawn"
        )
    schedules, chance, _ = mixture(game, best_rounds(game))
    exposed = [evaluate_followed(game, routes).exposure for routes in schedules]
    mean = chance @ np.array(exposed)
    risk = float((mean * game.value).max())
    least = not risk or least_risk(game) is not None
    return DrawnSchedules(tuple(schedules), chance, mean, risk, least)


def _shifted(route: Route, ahead: float) -> Route:
    """Return a route as it goes on from a moment."""
    arrive = (route.arrive - ahead) % route.period
    order = np.argsort(arrive, kind="stable")
    leave = (arrive + route.leave - route.arrive)[order]
    return dataclasses.replace(route, vertex=route.vertex[order], arrive=arrive[order], leave=leave)
