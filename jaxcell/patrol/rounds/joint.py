"""Schedules of all robots together, compared completely in small games with whole times.

If travel times and attacks are multiples of a unit, robots lose nothing if they leave targets at
multiples of it: the times of any schedule, rounded down to the unit, are those of another one,
whose times between visits exceed no attack that they did not exceed before. Over a random phase of
this rounding the exposures are those of the first schedule, too.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.sparse.csgraph
from jaxtyping import Float, Int

from .game import Game
from .route import Route


# Largest number of states in a search for safe schedules, which is divided by a factor per robot.
_STATES, _ROBOT = 300_000, 4
# Largest numbers of walks of all robots, and of moments that an adversary sees, and of bisections.
_WALKS, _SEEN, _HALVED = 1000, 8, 10
# Largest number of targets of a game in units of time.
_PLACES = 200
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

    def halved(self) -> "Clock":
        """Divide the unit by two."""
        ways = tuple(tuple((there, 2 * more + 1) for there, more in each) for each in self.ways)
        lasts = tuple(tuple(2 * one for one in each) for each in self.lasts)
        return Clock(self.unit / 2, ways, tuple(2 * a for a in self.attack), self.robots, lasts)

    def starts(self) -> Iterator[State]:
        """Yield states with all robots at targets, and all targets as if just visited."""
        every = [(target, 0) for target in range(len(self.attack))]
        for places in itertools.combinations_with_replacement(every, self.robots):
            yield places, self.attack


def clock_of(game: Game) -> Clock | None:
    """Return a game in units of time, or `None` if its times have no common unit, or a tiny one."""
    if game.targets.size > _PLACES:
        return None
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


def _of_all_vertices(game: Game) -> Game:
    """Make targets of all vertices from which ways lead to targets and back."""
    shape = (len(game.names),) * 2
    matrix = scipy.sparse.csr_array((game.times, tuple(game.ends.T)), shape=shape)
    _, part = scipy.sparse.csgraph.connected_components(matrix, connection="strong")
    every = np.flatnonzero(part == part[game.targets[0]])
    attack, value = np.full(every.size, game.attack.max()), np.ones(every.size)
    attack[np.searchsorted(every, game.targets)] = game.attack
    return dataclasses.replace(game, targets=every, attack=attack, value=value)


def watched_risk(game: Game) -> float | None:
    """Bound the risk of all strategies, also random ones, for an adversary who sees the robots.

    In a game in steps he sees before each step where each robot is: at a vertex, also one that is
    no target, or on a way, and its direction. An attack that begins then is stopped by a visit in
    one of the steps that it takes. A robot at a vertex decides after he has seen it there.

    In seconds he sees this at any moment. The bound is for one who looks just before each multiple
    of a unit that divides all times, or of its half. What he then sees of a strategy, and whether
    its robots are in time, is the same with all times rounded down to multiples.

    **Returns:** a risk that no strategy undercuts, in steps of 1/1024 of the largest value. `None`
    if times have no common unit, or robots have too many places.
    """
    if game.components[0] > 1 or len(game.names) > _PLACES:
        return None
    if (clock := clock_of(everywhere := _of_all_vertices(game))) is None:
        return None
    targets = np.searchsorted(everywhere.targets, game.targets)
    clocks = [clock] if game.whole else [clock, clock.halved()]
    found = [_risk_by_clock(one, targets.tolist(), game.value) for one in clocks]
    return max((risk for risk in found if risk is not None), default=None)


def _risk_by_clock(
    clock: Clock, targets: list[int], value: Float[np.ndarray, "targets"]
) -> float | None:
    """Bound the risk for an adversary who sees as many of the last units as there is room for.

    The variables of a linear program are the shares of moments at which robots walk each way in
    these and in the units of an attack; shares without the first moment are those without the last
    one. Given what he sees, each attack must be stopped often enough; the risk for which this is
    possible is bisected.
    """
    every = [next(clock.starts())[0]]
    number, near = {every[0]: 0}, []
    for places in every:
        after = [there for (there, _), _ in clock.after((places, clock.attack))]
        near.append([number.setdefault(there, len(number)) for there in after])
        every += list(number)[len(every) :]
        if len(every) > _WALKS:
            return None
    visited = np.array([[(t, 0) in places for t in targets] for places in every])
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
        [
            visited[walks[:, seen : seen + clock.attack[t]], k].any(axis=1)
            for k, t in enumerate(targets)
        ]
    )
    ends = np.unique(np.append(walks[:, :-1], walks[:, 1:], axis=0), axis=0, return_inverse=True)[1]
    before = np.unique(walks[:, :seen], axis=0, return_inverse=True)[1]
    count, ones = len(walks), np.ones(len(walks))
    rows = np.append(ends.ravel(), np.full(count, ends.max() + 1))
    signs, column = np.concatenate([ones, -ones, ones]), np.arange(count)
    balance = scipy.sparse.csr_array((signs, (rows, np.tile(column, 3))))
    each = before.ravel() + np.arange(value.size)[:, None] * (before.max() + 1)
    low, high = 0.0, float(value.max())
    for _ in range(_HALVED):
        risk = (low + high) / 2
        missing = (1 - risk / value)[:, None] - caught
        late = scipy.sparse.csr_array(
            (missing.ravel(), (each.ravel(), np.tile(column, value.size)))
        )
        total = np.append(np.zeros(int(ends.max()) + 1), 1.0)
        found = scipy.optimize.linprog(0 * ones, late, np.zeros(late.shape[0]), balance, total)
        if found.status == 2:
            low = risk
        else:
            high = risk
    return low
