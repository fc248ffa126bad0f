"""Rounds for unequal attacks, improved by random changes.

Visits on the way count: the robots of a tour are in time at a target if the tour passes it often.
"""

import functools
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from .game import Game


# Number of changes that are tried from each start: at most the first one, less for few and for many
# targets; and the first and last temperature, in shares of the largest value.
_CHANGES, _FEW, _MANY, _HOT, _COLD = 4000, 40, 400_000, 0.03, 0.0003
# Relative rounding error of a time.
_ROUNDING = 1e-9

# The stops of a tour in order, and its number of robots.
_Tour: TypeAlias = tuple[tuple[int, ...], int]


class _Tours:
    """The exposures of closed tours in a game, each computed once."""

    def __init__(self, game: Game) -> None:
        self.game, self.between = game, game.between
        self.target = np.full(len(game.names), -1)
        self.target[game.targets] = np.arange(game.targets.size)
        self.leg = functools.cache(self._leg)
        self.exposure = functools.cache(self._exposure)

    def _leg(
        self, here: int, there: int
    ) -> tuple[Int[np.ndarray, "visits"], Float[np.ndarray, "visits"]]:
        """List the targets on the shortest way between two, without the last, and their times."""
        vertex, times, _ = self.game.walk(np.array([here, there]))
        way = (times < self.between[here, there]) & (self.target[vertex] >= 0)
        return self.target[vertex[way]], times[way]

    def _exposure(self, order: tuple[int, ...], robots: int) -> Float[np.ndarray, "targets"]:
        """Compute the exposure of each target by evenly spaced robots on a tour."""
        exposed = np.ones(self.game.targets.size)
        if len(order) == 1:
            exposed[order[0]] = 0.0
            return exposed
        following = order[1:] + order[:1]
        legs = [self.leg(*ends) for ends in zip(order, following, strict=True)]
        begins = np.cumsum(np.append(0.0, self.between[order, following]))
        period = begins[-1] / robots
        target = np.concatenate([each for each, _ in legs])
        times = np.concatenate([at + begin for (_, at), begin in zip(legs, begins, strict=False)])
        sort = np.lexsort((times := times % period, target))
        target, times = target[sort], times[sort]
        first = np.flatnonzero(np.append(True, np.diff(target)))
        after = np.append(times[1:], 0.0)
        after[np.append(first[1:], times.size) - 1] = times[first] + period
        late = after - times - self.game.attack[target]
        late[late < _ROUNDING * period] = 0.0
        exposed[target[first]] = np.add.reduceat(late, first) / period
        return exposed

    def loss(self, tours: list[_Tour]) -> float:
        """Compute the sum of the largest and the mean risk, if tours meet in all phases."""
        exposed = np.array([self.exposure(*tour) for tour in tours]).prod(axis=0)
        risk = exposed * self.game.value
        return float(risk.max() + risk.mean())

    def with_stop(self, order: tuple[int, ...], target: int) -> tuple[int, ...]:
        """Insert a target where the tour becomes the least longer."""
        before = np.array(order)
        after = np.roll(before, -1)
        longer = self.between[before, target] + self.between[target, after]
        longer = longer - self.between[before, after]
        longer[(before == target) | (after == target)] += 1e-3 * self.between.max()
        place = int(longer.argmin()) + 1
        return (*order[:place], target, *order[place:])


def divide(game: Game) -> tuple[list[Int[np.ndarray, "_"]], list[int]]:
    """Give each of the shortest attacks a robot, which also visits the targets that are nearest.

    **Returns:** the stops of each tour, and its number of robots."""
    tours, count = _Tours(game), min(game.robots, game.targets.size)
    both = game.between + game.between.T
    heads = np.argsort(game.attack, kind="stable")[:count]
    orders: list[tuple[int, ...]] = [(head,) for head in heads.tolist()]
    for target in np.setdiff1d(np.arange(game.targets.size), heads).tolist():
        near = int(both[heads, target].argmin())
        orders[near] = tours.with_stop(orders[near], target)
    return [np.array(order) for order in orders], [1 + game.robots - count] + [1] * (count - 1)


def anneal(
    game: Game, orders: Sequence[Int[np.ndarray, "_"]], robots: Sequence[int]
) -> tuple[list[Int[np.ndarray, "_"]], list[int]]:
    """Improve rounds by random changes, which are also accepted now and then if they are worse.

    A change inserts a stop, removes one, turns a part of a tour round, moves a target to another
    tour, or sends a robot to another tour or to stay at a target. The same numbers are drawn for
    each game.

    **Returns:** the stops of each tour, and its number of robots."""
    random, tours = np.random.default_rng(0), _Tours(game)
    now = [
        (_without_repeats(tuple(order.tolist())), count)
        for order, count in zip(orders, robots, strict=True)
    ]
    loss = least = tours.loss(now)
    best, count = now, game.targets.size
    changes = min(_CHANGES, _FEW * count**2, _MANY // count)
    for heat in np.geomspace(_HOT, _COLD, changes) * game.value.max():
        changed = _changed(tours, now, random)
        new = tours.loss(changed)
        if new <= loss or random.random() < np.exp((loss - new) / heat):
            now, loss = changed, new
            if loss < least:
                best, least = now, loss
                if not least:
                    break
    return [np.array(order) for order, _ in best], [count for _, count in best]


def _changed(tours: _Tours, now: list[_Tour], random: np.random.Generator) -> list[_Tour]:
    """Change one or two tours at random."""
    risk = np.array([tours.exposure(*tour) for tour in now]).prod(axis=0) * tours.game.value
    # Mostly a target at risk.
    weight = risk + 0.5 * max(risk.max(), 1e-9)
    target = int(random.choice(risk.size, p=weight / weight.sum()))
    one, other = random.integers(len(now), size=2).tolist()
    changed, (order, robots) = list(now), now[one]
    kind = random.integers(5)
    if kind == 0:
        changed[one] = tours.with_stop(order, target), robots
    elif kind == 1 and len(order) > 1:
        place = int(random.integers(len(order)))
        changed[one] = order[:place] + order[place + 1 :], robots
    elif kind == 2 and len(order) > 2:
        low, high = np.sort(random.choice(len(order) + 1, 2, replace=False)).tolist()
        changed[one] = order[:low] + order[low:high][::-1] + order[high:], robots
    elif kind == 3:
        changed = [
            (tuple(stop for stop in stops if stop != target) or (target,), count)
            for stops, count in now
        ]
        order, robots = changed[one]
        changed[one] = tours.with_stop(order, target), robots
    elif kind == 4:
        # A robot of a tour goes to another one, or to the target; stops without robots are moved.
        stay = other == one or random.random() < 0.5
        left = [] if robots > 1 else list(order)
        changed[one] = order, robots - 1
        if stay:
            changed.append(((target,), 1))
        else:
            changed[other] = changed[other][0], changed[other][1] + 1
        changed = [tour for tour in changed if tour[1]]
        for stop in left:
            if changed and stop != target:
                k = int(random.integers(len(changed)))
                changed[k] = tours.with_stop(changed[k][0], stop), changed[k][1]
    return [(_without_repeats(order), robots) for order, robots in changed]


def _without_repeats(order: tuple[int, ...]) -> tuple[int, ...]:
    """Remove stops at the target of the stop before."""
    kept = tuple(stop for k, stop in enumerate(order) if stop != order[k - 1])
    return kept or order[:1]
