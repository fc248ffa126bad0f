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
# Largest number of moves between states in a linear program for the least risk.
_MOVES = 12_000
# Largest denominator of times relative to the first one, and largest number of units in a time.
_DENOMINATOR, _UNITS = 1000, 200
# Relative rounding error of a time.
_ROUNDING = 1e-9

# For each robot the target that it is at, or next at, and the time until then.
_Places: TypeAlias = tuple[tuple[int, int], ...]
# The places, and for each target the time until an attack succeeds that began after the last visit.
_State: TypeAlias = tuple[_Places, tuple[int, ...]]
# States one after another, with the robot of the state before that goes to each place.
_Path: TypeAlias = list[tuple[_State, tuple[int, ...]]]


class _Clock(NamedTuple):
    """A game whose times are multiples of a unit. Ways lead between targets, without others."""

    unit: float
    ways: tuple[tuple[tuple[int, int], ...], ...]
    "For each target, the targets that are reached from it, and the times, less the first unit."
    attack: tuple[int, ...]
    robots: int
    lasts: tuple[tuple[float, ...], ...]
    "The time from each target to each."

    def in_time(self, state: _State) -> bool:
        """Check whether some robot can reach each target before an attack there succeeds."""
        places, left = state
        near = [[more + one for one in self.lasts[target]] for target, more in places]
        return all(min(times) <= one for one, *times in zip(left, *near, strict=True))

    def after(self, state: _State) -> Iterator[tuple[_State, tuple[int, ...]]]:
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
                yield (
                    (
                        there,
                        tuple(
                            self.attack[target] if target in at else max(0, one - 1)
                            for target, one in enumerate(left)
                        ),
                    ),
                    order,
                )

    def starts(self) -> Iterator[_State]:
        """Yield states with all robots at targets, and all targets as if just visited."""
        every = [(target, 0) for target in range(len(self.attack))]
        for places in itertools.combinations_with_replacement(every, self.robots):
            yield places, self.attack


def clock_of(game: Game) -> _Clock | None:
    """Return a game in units of time, or `None` if its times have no common unit, or a tiny one."""
    between = game.between
    times = np.append(between[np.isfinite(between) & (between > 0)], game.attack)
    if game.whole:
        unit, attack = 1.0, np.floor(game.attack * (1 + _ROUNDING))
    else:
        ratios = [Fraction(t / times[0]).limit_denominator(_DENOMINATOR) for t in times.tolist()]
        unit = times[0] / math.lcm(*(ratio.denominator for ratio in ratios))
        attack = game.attack / unit
    if times.max() > _UNITS * unit or attack.min() < 1:
        return None
    if not np.allclose(times / unit, np.rint(times / unit), 0, 1e-6) and not game.whole:
        return None
    whole = np.where(np.isfinite(between), between / unit, 0).round().astype(int)
    ways = []
    for here, row in enumerate(whole):
        near = [
            (there, int(lasts) - 1)
            for there, lasts in enumerate(row.tolist())
            if lasts
            and not any(
                row[other] and whole[other, there] and row[other] + whole[other, there] == lasts
                for other in range(len(row))
                if other not in (here, there)
            )
        ]
        ways.append(tuple(near))
    return _Clock(
        unit,
        tuple(ways),
        tuple(attack.round().astype(int).tolist()),
        game.robots,
        tuple(map(tuple, np.where(np.isfinite(between), whole, np.inf).tolist())),
    )


@functools.lru_cache(maxsize=4)
def safe_routes(game: Game) -> tuple[Route, ...] | None:
    """Search for routes by which no attack succeeds, among all joint schedules.

    The states are the places of robots and the times left until attacks succeed. A state that has
    at most the times of a state without future has none either; a path that returns to the same
    places with at least the same times is repeated without end.

    **Returns:** the routes, without any if there are none, which is proved by the search; `None` if
    times have no common unit, or there are too many states.
    """
    clock = clock_of(game)
    if clock is None:
        return None
    dead: dict[_Places, list[tuple[int, ...]]] = {}
    states = 0
    for start in clock.starts():
        path: _Path = [(start, (0,))]
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
                        return _routes(game, clock, path[begin:])
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


def _by_time_left(clock: _Clock, state: _State) -> Iterator[tuple[_State, tuple[int, ...]]]:
    """Return the states after a state, first those with much time left at the worst target."""
    share = clock.attack
    return iter(
        sorted(
            (one for one in clock.after(state) if min(one[0][1]) and clock.in_time(one[0])),
            key=lambda one: -min(a / b for a, b in zip(one[0][1], share, strict=True)),
        )
    )


def _within(less: tuple[int, ...], more: tuple[int, ...]) -> bool:
    return all(a <= b for a, b in zip(less, more, strict=True))


def _routes(game: Game, clock: _Clock, path: _Path) -> tuple[Route, ...]:
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
        vertex, times, takes = game.walk(at[[begin, after]])
        takes = float(game.between[at[begin], at[after]])
        way = (times > 0) & (times < takes)
        passed = visits[-1][2] + times[way]
        visits += zip(vertex[way].tolist(), passed.tolist(), passed.tolist(), strict=True)
    vertex, arrive, leave = (np.array(column) for column in zip(*visits, strict=True))
    stays, arrive = leave - arrive, arrive % period
    order = np.argsort(arrive, kind="stable")
    return Route(vertex[order], arrive[order], (arrive + stays)[order], period)


def least_risk(game: Game) -> float | None:
    """Compute the least risk of all strategies for an adversary who comes at a random time.

    The variables of a linear program are the shares of time for moves between the states of
    [`safe_routes`][], whose sum into a state is that out of it. The risk is the largest value of a
    target times the share of units in which an attack begins that succeeds.

    **Returns:** the risk, or `None` if times have no common unit, or there are too many moves.
    """
    if game.components[0] > 1 or (clock := clock_of(game)) is None:
        return None
    after: dict[_State, list[_State]] = {}
    stack, count = [next(clock.starts())], 0
    while stack:
        if (state := stack.pop()) not in after:
            after[state] = [one for one, _ in clock.after(state)]
            stack += after[state]
            count += len(after[state])
            if count > _MOVES:
                return None
    number = {state: k for k, state in enumerate(after)}
    begins = np.repeat(np.arange(len(after)), [len(each) for each in after.values()])
    ends = np.array([number[state] for each in after.values() for state in each])
    late = np.array([left for _, left in after])[begins] == 0
    ones, column = np.ones(count), np.arange(count)
    balance = scipy.sparse.csr_array(
        (np.append(ones, -ones), (np.append(begins, ends), np.tile(column, 2))),
        (len(after), count + 1),
    )
    rows = np.append(late.T * game.value[:, None], -np.ones((game.value.size, 1)), axis=1)
    total = np.append(ones, 0.0)
    found = scipy.optimize.linprog(
        1 - total,
        rows,
        np.zeros(game.value.size),
        scipy.sparse.vstack([balance, total[None]], format="csr"),
        np.append(np.zeros(len(after)), 1.0),
        method="highs",
    )
    if not found.success:
        raise RuntimeError(f"the least risk: {found.message}")
    return float(found.fun)
