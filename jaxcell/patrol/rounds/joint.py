"""Schedules of all robots together, compared completely in small games with whole times.

If travel times and attacks are multiples of a unit, robots lose nothing if they leave targets at
multiples of it: the times of any schedule, rounded down to the unit, are those of another one,
whose times between visits exceed no attack that they did not exceed before. Over a random phase of
this rounding the exposures are those of the first schedule, too.
"""

import functools
import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Int

from .game import Game
from .route import Route


# Largest number of states in a search for safe schedules, which is divided by a factor per robot.
_STATES, _ROBOT = 300_000, 4
# Largest numbers of walks of all robots, and of moments that an adversary sees, and of bisections.
_WALKS, _SEEN, _HALVED = 1000, 8, 10
# Largest denominator of times relative to the first one, and largest number of units in a time.
_DENOMINATOR, _UNITS = 1000, 200
# Relative rounding error of a time.
_ROUNDING = 1e-9

# For each robot the target that it is at, or next at, and the time until then.
_Places: TypeAlias = tuple[tuple[int, int], ...]
# The places, and for each target the time until an attack succeeds that began after the last visit.
State: TypeAlias = tuple[_Places, tuple[int, ...]]
# States one after another, with the robot of the state before that goes to each place.
Path: TypeAlias = list[tuple[State, tuple[int, ...]]]


class Clock(NamedTuple):
    """A game whose times are multiples of a unit. Ways lead between targets, without others."""

    unit: float
    ways: tuple[tuple[tuple[int, int], ...], ...]
    "For each target, the targets that are reached from it, and the times, less the first unit."
    attack: tuple[int, ...]
    robots: int
    lasts: tuple[tuple[float, ...], ...]
    "The time from each target to each."

    def in_time(self, state: State) -> bool:
        """Check whether some robot can reach each target before an attack there succeeds."""
        places, left = state
        near = [[more + one for one in self.lasts[target]] for target, more in places]
        return all(min(times) <= one for one, *times in zip(left, *near, strict=True))

    def after(self, state: State) -> Iterator[tuple[State, tuple[int, ...]]]:
        """Yield the states one unit later, and for each place the robot that goes there."""
        places, left = state
        each = [
            ((target, more - 1),) if more else ((target, 0), *self.ways[target])
            for target, more in places
        ]
        seen = set()
        for chosen in itertools.product(*each):
            order = tuple(sorted(range(self.robots), key=chosen.__getitem__))
            there = tuple(chosen[robot] for robot in order)
            if there not in seen:
                seen.add(there)
                at = {target for target, more in there if not more}
                now = tuple(
                    self.attack[target] if target in at else max(0, one - 1)
                    for target, one in enumerate(left)
                )
                yield (there, now), order

    def starts(self) -> Iterator[State]:
        """Yield states with all robots at targets, and all targets as if just visited."""
        every = [(target, 0) for target in range(len(self.attack))]
        for places in itertools.combinations_with_replacement(every, self.robots):
            yield places, self.attack


def clock_of(game: Game) -> Clock | None:
    """Return a game in units of time, or `None` if its times have no common unit, or a tiny one."""
    between = game.between
    times = np.append(between[np.isfinite(between) & (between > 0)], game.attack)
    if game.whole:
        unit, attack = 1.0, np.floor(game.attack * (1 + _ROUNDING))
    else:
        ratios = [Fraction(t / times[0]).limit_denominator(_DENOMINATOR) for t in times.tolist()]
        unit = times[0] / math.lcm(*(ratio.denominator for ratio in ratios))
        attack = game.attack / unit
    even = game.whole or np.allclose(times / unit, np.rint(times / unit), 0, 1e-6)
    if times.max() > _UNITS * unit or times.min() < unit / 2 or attack.min() < 1 or not even:
        return None
    lasts = np.rint(between / unit)
    away = lasts + np.diag(np.full(len(lasts), np.inf))
    # No other target is on the way.
    direct = away < (away[:, :, None] + away[None]).min(axis=1)
    ways = tuple(
        tuple((there, int(row[there]) - 1) for there in np.flatnonzero(only).tolist())
        for row, only in zip(away, direct, strict=True)
    )
    whole = tuple(attack.round().astype(int).tolist())
    return Clock(unit, ways, whole, game.robots, tuple(map(tuple, lasts.tolist())))


@functools.lru_cache(maxsize=4)
def safe_routes(game: Game) -> tuple[Route, ...] | None:
    """Search for routes by which no attack succeeds, among all joint schedules.

    The states are the places of robots and the times left until attacks succeed. A state that has
    at most the times of a state without future has none either; a path that returns to the same
    places with at least the same times is repeated without end.

    **Returns:** the routes, without any if there are none, which is proved by the search; `None` if
    times have no common unit, or there are too many states.
    """
    if (clock := clock_of(game)) is None:
        return None
    dead: dict[_Places, list[tuple[int, ...]]] = {}
    states = 0
    for start in clock.starts():
        path: Path = [(start, (0,))]
        above = {start[0]: [0]}
        stack = [_by_time_left(clock, start)]
        while stack:
            for state, order in stack[-1]:
                places, left = state
                if any(_within(left, one) for one in dead.get(places, ())):
                    continue
                path.append((state, order))
                for begin in above.get(places, ()):
                    if _within(path[begin][0][1], left):
                        return routes_along(game, clock, path[begin:])
                above.setdefault(places, []).append(len(path) - 1)
                stack.append(_by_time_left(clock, state))
                states += 1
                if states > _STATES // _ROBOT**game.robots:
                    return None
                break
            else:
                stack.pop()
                places, left = path.pop()[0]
                above[places].pop()
                others = [one for one in dead.get(places, ()) if not _within(one, left)]
                dead[places] = [*others, left]
    return ()


def _by_time_left(clock: Clock, state: State) -> Iterator[tuple[State, tuple[int, ...]]]:
    """Return the states after a state, first those with much time left at the worst target."""

    def least(one: tuple[State, tuple[int, ...]]) -> float:
        return min(a / b for a, b in zip(one[0][1], clock.attack, strict=True))

    after = (one for one in clock.after(state) if min(one[0][1]) and clock.in_time(one[0]))
    return iter(sorted(after, key=least, reverse=True))


def _within(less: tuple[int, ...], more: tuple[int, ...]) -> bool:
    return all(a <= b for a, b in zip(less, more, strict=True))


def routes_along(game: Game, clock: Clock, path: Path) -> tuple[Route, ...]:
    """Follow the robots along a path of states that ends at the places where it begins."""
    # At the end of the path, robots may have changed their places.
    begin = here = list(range(game.robots))
    at: list[list[int]] = [[] for _ in begin]
    while not at[0] or here != begin:
        for (places, _), order in path[1:]:
            here = [order.index(place) for place in here]
            for robot, place in enumerate(here):
                target, more = places[place]
                at[robot].append(-1 if more else target)
    return tuple(_route(game, np.array(each), clock.unit) for each in at)


def _route(game: Game, at: Int[np.ndarray, "moments"], unit: float) -> Route:
    """Return the route of a robot from its target at each moment of a period; -1 is on the way."""
    period = at.size * unit
    begins = np.flatnonzero((at >= 0) & (at != np.roll(at, 1)))
    if not begins.size:
        return Route(game.targets[at[:1]], np.zeros(1), np.full(1, period), period)
    visits = []
    for begin, after in zip(begins.tolist(), np.roll(begins, -1).tolist(), strict=True):
        lasts = int(np.argmax(np.roll(at, -begin) != at[begin])) - 1
        visits.append((game.targets[at[begin]], begin * unit, (begin + lasts) * unit))
        vertex, times, _ = game.walk(at[[begin, after]])
        way = (times > 0) & (times < game.between[at[begin], at[after]])
        passed = visits[-1][2] + times[way]
        visits += zip(vertex[way].tolist(), passed.tolist(), passed.tolist(), strict=True)
    vertex, arrive, leave = (np.array(column) for column in zip(*visits, strict=True))
    stays, arrive = leave - arrive, arrive % period
    order = np.argsort(arrive, kind="stable")
    return Route(vertex[order], arrive[order], (arrive + stays)[order], period)


def watched_risk(game: Game) -> float | None:
    """Bound the risk of all strategies, also random ones, for an adversary who sees the robots.

    He sees their places at the last moments, as many as a linear program has room for. Its
    variables are the shares of moments at which robots walk each way in these and in the moments of
    an attack; shares without the first moment are those without the last one. Given what he sees,
    each attack must be stopped often enough; the risk for which this is possible is bisected.

    **Returns:** the bound; it is the optimum if he sees no more. `None` if times have no common
    unit, or there are too many walks.
    """
    if game.components[0] > 1 or (clock := clock_of(game)) is None:
        return None
    every = [next(clock.starts())[0]]
    number, near = {every[0]: 0}, []
    for places in every:
        after = [there for (there, _), _ in clock.after((places, clock.attack))]
        near.append([number.setdefault(there, len(number)) for there in after])
        every += list(number)[len(every) :]
        if len(every) > _WALKS:
            return None
    visited = np.array([[(t, 0) in places for t in range(game.targets.size)] for places in every])
    walks, longest = np.arange(len(every))[:, None], max(clock.attack)
    while walks.shape[1] < longest + _SEEN:
        more = [near[end] for end in walks[:, -1].tolist()]
        if sum(map(len, more)) > _WALKS:
            break
        walks = np.repeat(walks, list(map(len, more)), axis=0)
        walks = np.append(walks, np.concatenate(more)[:, None], axis=1)
    if (seen := walks.shape[1] - longest) < 1:
        return None
    caught = np.array(
        [visited[walks[:, seen : seen + a], t].any(axis=1) for t, a in enumerate(clock.attack)]
    )
    ends = np.unique(np.append(walks[:, :-1], walks[:, 1:], axis=0), axis=0, return_inverse=True)[1]
    before = np.unique(walks[:, :seen], axis=0, return_inverse=True)[1]
    count, ones = len(walks), np.ones(len(walks))
    rows = np.append(ends.ravel(), np.full(count, ends.max() + 1))
    signs, column = np.concatenate([ones, -ones, ones]), np.arange(count)
    balance = scipy.sparse.csr_array((signs, (rows, np.tile(column, 3))))
    each = before.ravel() + np.arange(game.value.size)[:, None] * (before.max() + 1)
    low, high = 0.0, float(game.value.max())
    for _ in range(_HALVED):
        risk = (low + high) / 2
        missing = (1 - risk / game.value)[:, None] - caught
        late = scipy.sparse.csr_array(
            (missing.ravel(), (each.ravel(), np.tile(column, game.value.size)))
        )
        total = np.append(np.zeros(int(ends.max()) + 1), 1.0)
        found = scipy.optimize.linprog(0 * ones, late, np.zeros(late.shape[0]), balance, total)
        if found.status == 2:
            low = risk
        else:
            high = risk
    return low
