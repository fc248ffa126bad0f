"""Mixtures of rounds, one after another, for an adversary who comes at a random time."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize
from jaxtyping import Float

from .blind import blind_schedules
from .evaluation import evaluate_followed
from .game import Game
from .joint import safe_routes
from .route import Route
from .search import Rounds, best_rounds, rounds_of, spaced
from .subsets import MOST_ROBOTS, MOST_SUBSETS, best_division, closed_tours, membership


# Periods of a mixture, relative to its longest round. The shortest one is taken whose risk is
# within a share of the largest value of the least.
_PERIODS, _LOSS = (5, 20, 100), 0.01
# The share of the largest value for which targets are not visited for a long time.
_GAIN = 0.02
# Largest number of places where robots stay.
_STAYS = 12
# Relative difference below which risks are equal.
_SAME = 1e-7
# Largest number of targets for more than two robots, whose divisions are searched many times.
_DIVIDED = 11
# Largest number of rounds that are tried in a mixture, and the least share of one.
_TRIED, _LEAST = 60, 1e-3


class Mixture(NamedTuple):
    """Shares with which the largest risk is least."""

    risk: float
    shares: Float[np.ndarray, "patrols"]
    worth: Float[np.ndarray, "targets"]
    "By how much the risk would decrease per capture on each target."
    level: float
    "The least sum of capture times worth of a patrol whose share would decrease the risk."


def mix(capture: Float[np.ndarray, "patrols targets"], value: Float[np.ndarray, "_"]) -> Mixture:
    """Mix patrols that capture attacks with given probabilities so that the risk is least."""
    cost = np.append(np.zeros(len(capture)), 1.0)
    # The value of each target times its probability of no visit is at most the risk.
    rows = np.append(-capture.T * value[:, None], -np.ones((value.size, 1)), axis=1)
    once = np.append(np.ones(len(capture)), 0.0)[None]
    found = scipy.optimize.linprog(cost, rows, -value, once, [1.0], method="highs")
    if not found.success:
        raise RuntimeError(f"the mixture: {found.message}")
    worth = -found.ineqlin.marginals * value
    return Mixture(float(found.fun), found.x[:-1], worth, -float(found.eqlin.marginals[0]))


def best_routes(game: Game) -> tuple[Route, ...]:
    """Search for routes of robots with the least risk.

    These are the routes of [`best_rounds`][] or, if an attack on them succeeds, those of
    `safe_routes` where some exist. For an adversary who comes at a random time, robots also
    stay at some targets of their tours while others are not late. For up to 14 targets and 2
    robots, or 11 targets and 4 robots, rounds through some of the targets are repeated in turn,
    each for a share of a long period, if the risk is then less by 2 % of the largest value. The
    shares solve a linear program, whose rounds are found one by one, by their capture at its
    prices. In small games whose times are multiples of a unit, all joint schedules are mixed
    instead; a single one of them is taken if it is the best of all strategies.

    **Arguments:** the game. **Returns:** a route for each robot. **Raises:** `ValueError` if there
    are fewer robots than parts of the graph.

    Attacks that take 1 step, on two vertices that are 3 s apart: a guard stays long at each.

        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1]], xy=[[0, 0], [3, 0]])
        >>> game = patrol.rounds.Game.of(line, 1.0, speed=1.0)
        >>> once = patrol.rounds.best_rounds(game).evaluation
        >>> longer = patrol.rounds.evaluate(game, patrol.rounds.best_routes(game))
        >>> once.exposure.round(3).tolist(), longer.exposure.round(3).tolist()
        ([0.833, 0.833], [0.507, 0.507])
    """
    found = best_rounds(game)
    best, risk = _safest(game, found.routes, float(found.evaluation.risk(game).max()))
    if game.adversary == "blind" and risk > 0 and best is found.routes:
        best, risk = _with_stays(found, risk)
    if game.adversary != "blind" or not _is_mixed(game) or risk <= 0:
        return best
    most = float(game.value.max())
    enough, turns = risk - _GAIN * most, best
    schedules, shares, limit = mixture(game, found)
    if len(schedules) == 1 and limit < risk - _SAME * most:
        return schedules[0]
    for period in _PERIODS if limit < enough else ():
        turns = _alternated(game, schedules, shares, period)
        risk = float(evaluate_followed(game, turns).risk(game).max())
        if risk <= limit + _LOSS * most:
            break
    return turns if risk < enough else best


def _is_mixed(game: Game) -> bool:
    """Check whether targets and robots are few enough to mix rounds."""
    most = MOST_SUBSETS if game.robots <= 2 else _DIVIDED
    few = game.robots <= MOST_ROBOTS and game.targets.size <= most
    return few and game.components[0] == 1


def mixture(
    game: Game, first: Rounds
) -> tuple[list[tuple[Route, ...]], Float[np.ndarray, "schedules"], float]:
    """Find schedules, their shares of the time, and the risk if changes took no time."""
    if safe := safe_routes(game):
        return [safe], np.ones(1), 0.0
    schedules = [first.routes, *blind_schedules(game)]
    if len(schedules) == 1 and _is_mixed(game):
        schedules = _rounds_to_mix(game, first)
    exposed = [evaluate_followed(game, routes).exposure for routes in schedules]
    mixed = mix(1 - np.array(exposed), game.value)
    used = np.flatnonzero(mixed.shares > _SAME)
    shares = mixed.shares[used] / mixed.shares[used].sum()
    return [schedules[k] for k in used.tolist()], shares, mixed.risk


def _safest(game: Game, routes: tuple[Route, ...], risk: float) -> tuple[tuple[Route, ...], float]:
    """Take joint schedules by which no attack on the most valuable targets succeeds, if better."""
    for level in np.append(0.0, np.unique(game.value)):
        if level >= risk:
            break
        kept = game.value > level
        part = dataclasses.replace(
            game, targets=game.targets[kept], attack=game.attack[kept], value=game.value[kept]
        )
        if safe := safe_routes(part if level else game):
            if (lower := float(evaluate_followed(game, safe).risk(game).max())) < risk:
                return safe, lower
            break
    return routes, risk


def _with_stays(found: Rounds, risk: float) -> tuple[tuple[Route, ...], float]:
    """Stay at the targets with the largest risks in their tours while this lowers the risk."""
    game, best, stays = found.game, found.routes, [dict[int, float]() for _ in found.orders]
    exposed, first = found.evaluation, np.cumsum([0, *found.robots]).tolist()
    for _ in range(_STAYS):
        worst = int(exposed.risk(game).argmax())
        tours = [tour for tour, order in enumerate(found.orders) if worst in order]
        if not tours or found.orders[tours[0]].size < 2:
            break
        tour, at, better = tours[0], int(game.targets[worst]), None
        robots, order, begin = found.robots[tour], found.orders[tour], first[tour]
        route, value = best[begin], game.value
        # The periods in which another target is not late, or is at the same risk.
        late = exposed.exposure[worst] * route.period * value[worst] / value
        passed = np.isin(game.targets, route.vertex)
        chosen = np.unique((robots * game.attack + [np.zeros(late.size), late])[:, passed])
        for period in chosen[chosen > route.period].tolist():
            lasts = stays[tour].get(at, 0.0) + period - route.period
            more = stays[tour] | {at: float(np.floor(lasts)) if game.whole else lasts}
            routes = (*best[:begin], *spaced(game, order, robots, more), *best[begin + robots :])
            now = evaluate_followed(game, routes)
            if (lower := float(now.risk(game).max())) < risk * (1 - _SAME):
                better, risk = (routes, more, now), lower
        if better is None:
            break
        best, stays[tour], exposed = better
    return best, risk


def _rounds_to_mix(game: Game, first: Rounds) -> list[tuple[Route, ...]]:
    """Find rounds that lower the risk of their mixture, one by one."""
    lengths = closed_tours(game.between)
    inside = membership(game.targets.size)
    with np.errstate(divide="ignore"):
        often = [
            np.minimum(1.0, several * game.attack / lengths[:, None]) * inside
            for several in range(1, game.robots + 1)
        ]
    rounds, capture = [first], [1 - first.evaluation.exposure]
    for _ in range(_TRIED):
        mixed = mix(np.array(capture), game.value)
        gains = [_with_parts(each @ mixed.worth) for each in often]
        groups = best_division([-gain for gain, _ in gains], np.add)
        bit = 1 << np.arange(game.targets.size)
        chosen = [
            (np.flatnonzero(inside[gains[own - 1][1][bit[part].sum()]]).tolist(), own)
            for part, own in groups
        ]
        new = rounds_of(game, [(part, own) for part, own in chosen if part])
        now = 1 - new.evaluation.exposure
        if now @ mixed.worth <= mixed.level + _LEAST * game.value.max():
            break
        rounds.append(new)
        capture.append(now)
    return [one.routes for one in rounds]


def _with_parts(
    gain: Float[np.ndarray, "sets"],
) -> tuple[Float[np.ndarray, "sets"], "np.ndarray"]:
    """Return the largest gain of any part of each set, and the number of this part."""
    gain, part = gain.copy(), np.arange(len(gain))
    for bit in range(len(gain).bit_length() - 1):
        larger = np.flatnonzero(np.arange(len(gain)) >> bit & 1)
        smaller = larger ^ (1 << bit)
        better = gain[smaller] > gain[larger]
        gain[larger] = np.where(better, gain[smaller], gain[larger])
        part[larger] = np.where(better, part[smaller], part[larger])
    return gain, part


def _alternated(
    game: Game,
    schedules: Sequence[tuple[Route, ...]],
    shares: Float[np.ndarray, "schedules"],
    periods: int,
) -> tuple[Route, ...]:
    """Repeat each of some rounds for its share of a period, and walk from one to the next."""
    number = {vertex: target for target, vertex in enumerate(game.targets.tolist())}
    walked = [route.period for one in schedules for route in one if route.vertex.size > 1]
    whole = periods * max([*walked, float(game.between.max())])
    phases = []
    for followed, share in zip(schedules, shares.tolist(), strict=True):
        lasts = float(np.ceil(share * whole) if game.whole else share * whole)
        phases.append([_repeated(route, lasts, number) for route in followed])
    order = np.arange(game.robots)
    visits: list[list[tuple[int, float, float]]] = [[] for _ in range(game.robots)]
    now = 0.0
    for phase, after in zip(phases, [*phases[1:], phases[0]], strict=True):
        ends = np.array([number[phase[one][-1][0]] for one in order.tolist()])
        begins = np.array([number[route[0][0]] for route in after])
        takes = game.between[np.ix_(ends, begins)]
        # In the last change each robot returns to where it began.
        following = np.arange(game.robots)
        if after is not phases[0]:
            following = scipy.optimize.linear_sum_assignment(takes)[1]
        needed = [
            phase[one][-1][1] + takes[robot, other] - after[other][0][1]
            for robot, (one, other) in enumerate(zip(order, following, strict=True))
        ]
        lasts = max([*needed, *(route[-1][2] for route in phase)])
        for robot, (one, other) in enumerate(zip(order.tolist(), following.tolist(), strict=True)):
            times = [(v, now + a, now + b) for v, a, b in phase[one]]
            leaves = now + lasts + after[other][0][1] - float(takes[robot, other])
            leaves = max(leaves, times[-1][1])
            times[-1] = (*times[-1][:2], leaves)
            visits[robot] += times
            if ends[robot] != begins[other]:
                vertex, at, _ = game.walk(np.array([ends[robot], begins[other]]))
                way = (at > 0) & (at < takes[robot, other])
                visits[robot] += [
                    (v, leaves + t, leaves + t)
                    for v, t in zip(vertex[way].tolist(), at[way].tolist(), strict=True)
                ]
        order, now = following, now + lasts
    columns = ([np.array(column) for column in zip(*each, strict=True)] for each in visits)
    return tuple(Route(vertex, arrive, leave, now) for vertex, arrive, leave in columns)


def _repeated(
    route: Route, duration: float, number: dict[int, int]
) -> list[tuple[int, float, float]]:
    """List the visits of a route for a duration, from its first target on, to its last one."""
    if route.vertex.size == 1:
        return [(int(route.vertex[0]), 0.0, duration)]
    duration = max(duration, route.period)
    begins = np.arange(0, duration, route.period)
    times = ((begins[:, None] + each).ravel().tolist() for each in (route.arrive, route.leave))
    vertex = np.tile(route.vertex, len(begins)).tolist()
    visits = [visit for visit in zip(vertex, *times, strict=True) if visit[1] <= duration]
    targets = [k for k, (v, _, _) in enumerate(visits) if v in number]
    return visits[targets[0] : targets[-1] + 1]
