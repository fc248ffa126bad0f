"""The search for rounds of robots that keep a shared clock."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from ...optimize.tour import best_order, good_order, improved_order, tour_length
from .annealing import anneal, divide
from .evaluation import Evaluation, evaluate_followed
from .game import Game
from .route import Route
from .subsets import MOST_ROBOTS, MOST_SUBSETS, best_partition, closed_tours


# Numbers of parts that are compared are at most this many, and grow by a factor.
_PARTS = 8
# Largest number of stops of a tour for which repeated visits are tried, and of trials.
_STOPS, _REPEATS = 40, 12
# Risks that differ by less are the same.
_SAME = 1e-9
# Lengths of the parts of a tour that move to another tour.
_MOVED = (1, 2, 3, 5, 8)

_Order: TypeAlias = Int[np.ndarray, "_"]


@dataclasses.dataclass(frozen=True, eq=False)
class Rounds:
    """Closed tours, each with evenly spaced robots, and their evaluation."""

    game: Game
    orders: tuple[_Order, ...]
    "The targets of each tour in order, by their index in the game."
    robots: tuple[int, ...]
    "The number of robots on each tour."
    routes: tuple[Route, ...]
    evaluation: Evaluation

    @classmethod
    def of(cls, game: Game, orders: Sequence[_Order], robots: Sequence[int]) -> "Rounds":
        routes = tuple(
            route
            for order, count in zip(orders, robots, strict=True)
            for route in spaced(game, order, count)
        )
        return cls(game, tuple(orders), tuple(robots), routes, evaluate_followed(game, routes))

    @property
    def rank(self) -> tuple[float, float, float, float]:
        """Numbers to compare rounds in this order; smaller is better."""
        found, game = self.evaluation, self.game
        late = found.longest / game.attack
        risk, exposed = found.risk(game).max(), (found.exposure * game.value).max()
        first, second = (max(0.0, round(float(loss), 9)) for loss in (risk, exposed))
        return first, second, float(late.max()), float(late.mean())


def best_rounds(game: Game) -> Rounds:
    """Search for rounds with the least risk.

    For up to 14 targets, the lengths of the shortest tours of all sets of targets are computed, and
    robots are divided among disjoint tours optimally. For more targets, tours are improved by
    exchanges: within a tour, and between tours. Then targets with short attacks are visited more
    often than others where this helps. Targets are left out if what they are worth is less than the
    risk of rounds with them. Of rounds with equal risk, those with the shortest times between
    visits are chosen, relative to attacks.

    If attacks or values differ, an attack succeeds, and the targets are one connected part, tours
    are also improved by random changes, which count visits on the way. The same numbers are drawn
    each time.

    **Arguments:** the game. **Returns:** `Rounds`. **Raises:** `ValueError` if there are fewer
    robots than parts of the graph.

    Two robots on a cycle of six vertices, where attacks take 3 steps:

        >>> from jaxcell import patrol
        >>> cycle = patrol.Graph([(i, (i + 1) % 6) for i in range(6)])
        >>> found = patrol.rounds.best_rounds(patrol.rounds.Game.of(cycle, 3.0, robots=2))
        >>> found.robots, found.evaluation.longest.max().item()
        ((2,), 3.0)
    """
    # With the targets left out of up to a value, the risk of the others decreases.
    levels = np.append(0.0, np.unique(game.value)[:-1])
    low, high, found = 0, len(levels) - 1, []
    while low <= high:
        level = (low + high) // 2
        kept = np.flatnonzero(game.value > levels[level])
        part = dataclasses.replace(
            game, targets=game.targets[kept], attack=game.attack[kept], value=game.value[kept]
        )
        best = min(_candidates(part), key=lambda rounds: rounds.rank)
        best = _with_repeats(Rounds.of(game, [kept[one] for one in best.orders], best.robots))
        found.append(best)
        if best.evaluation.risk(game)[kept].max() > levels[level]:
            low = level + 1
        else:
            high = level - 1
    best = min(found, key=lambda rounds: rounds.rank)
    return best if _is_uniform(game) or game.components[0] > 1 else _annealed(best)


def _annealed(best: Rounds) -> Rounds:
    """Improve rounds by random changes of them, of one tour, of nearby tours, and of the best."""
    game, one = best.game, ([np.concatenate(best.orders)], [best.game.robots])
    for start in [(best.orders, best.robots), one, divide(game), None]:
        if best.rank[0]:
            changed = anneal(game, *(start or (best.orders, best.robots)))
            best = min(best, Rounds.of(game, *changed), key=lambda rounds: rounds.rank)
    return best


def _is_uniform(game: Game) -> bool:
    return not np.ptp(game.attack) and not np.ptp(game.value)


def _candidates(game: Game) -> Iterator[Rounds]:
    between, (parts, part) = game.between, game.components
    if game.targets.size <= MOST_SUBSETS:
        lengths = closed_tours(between)
        for groups in best_partition(lengths, game.attack, game.value, game.robots):
            yield rounds_of(game, groups)
    whole = [_ordered(np.flatnonzero(part == one), between) for one in range(parts)]
    if parts > 1 or game.targets.size > MOST_SUBSETS:
        yield Rounds.of(game, whole, _shared_out(game, whole))
    several = np.geomspace(2, max(2, game.robots), _PARTS).round().astype(int)
    for count in np.unique(several[several <= game.robots]).tolist():
        if game.targets.size <= MOST_SUBSETS and game.robots <= MOST_ROBOTS:
            break
        tours = [
            tour
            for order, share in zip(whole, _shared_out(game, whole, count), strict=True)
            for tour in _split(order, between, min(share, order.size))
        ]
        tours = _balanced(tours, game, part)
        yield Rounds.of(game, tours, _shared_out(game, tours))


def rounds_of(game: Game, groups: Sequence[tuple[list[int], int]]) -> Rounds:
    """Follow short tours through groups of targets, with a number of robots for each."""
    orders = [_ordered(np.array(targets), game.between) for targets, _ in groups]
    counts = [count for _, count in groups]
    everyone = sum(counts) == game.robots
    return Rounds.of(game, orders, counts if everyone else _shared_out(game, orders))


def _ordered(targets: Int[np.ndarray, "part"], between: Float[np.ndarray, "all all"]) -> _Order:
    """Order targets into a short closed tour."""
    if targets.size < 3:
        return targets
    inside = between[np.ix_(targets, targets)]
    short = best_order if targets.size <= MOST_SUBSETS else good_order
    return targets[short(inside)]


def spaced(
    game: Game, order: _Order, robots: int, stays: Mapping[int, float] | None = None
) -> Iterator[Route]:
    """Yield the routes of robots that follow a tour at equal intervals.

    `stays` has durations for which a robot stays at a vertex, when it first comes there."""
    vertex, begins, duration = game.walk(order)
    if not duration:
        for _ in range(robots):
            yield Route(vertex, np.zeros(1), np.ones(1), 1.0)
        return
    stay = np.zeros(vertex.size)
    for place, lasts in (stays or {}).items():
        stay[int(np.argmax(vertex == place))] = lasts
    begins = begins + np.cumsum(stay) - stay
    duration += float(stay.sum())
    for robot in range(robots):
        ahead = robot * duration / robots
        arrive = (begins + (np.floor(ahead) if game.whole else ahead)) % duration
        turn = -int(arrive.argmin())
        arrive = np.roll(arrive, turn)
        yield Route(np.roll(vertex, turn), arrive, arrive + np.roll(stay, turn), duration)


def _late(game: Game, order: _Order) -> float:
    """Compute the duration of a tour relative to the shortest attack on it."""
    return tour_length(order, game.between) / float(game.attack[order].min())


def _shared_out(game: Game, orders: Sequence[_Order], robots: int | None = None) -> list[int]:
    """Return the number of robots on each tour that makes the longest interval shortest."""
    shared = np.ones(len(orders), np.int64)
    late = np.array([_late(game, order) for order in orders])
    for _ in range((game.robots if robots is None else max(robots, len(orders))) - len(orders)):
        shared[np.argmax(late / shared)] += 1
    return shared.tolist()


def _split(order: _Order, between: Float[np.ndarray, "all all"], parts: int) -> list[_Order]:
    """Cut a tour into parts of nearly equal duration, where their longest closed tour is least."""
    if parts == 1:
        return [order]
    best, least = [order], np.inf
    for turn in np.unique(np.linspace(0, order.size, 48, endpoint=False).astype(int)):
        turned = np.roll(order, -turn)
        reached = np.cumsum(np.append(0.0, between[turned[:-1], turned[1:]]))
        cuts = np.searchsorted(reached, reached[-1] * np.arange(1, parts) / parts)
        cuts = np.maximum(cuts, np.arange(1, parts))
        tours = [tour for tour in np.split(turned, cuts) if tour.size]
        longest = max(tour_length(tour, between) for tour in tours)
        if longest < least and len(tours) == parts:
            best, least = tours, longest
    return best


def _balanced(tours: list[_Order], game: Game, part: Int[np.ndarray, "targets"]) -> list[_Order]:
    """Move stops from the longest tour to others while the longest becomes shorter."""
    least = np.inf
    while True:
        tours = [improved_order(tour, game.between) for tour in tours]
        moved: tuple[int, _Order, _Order] | None
        for _ in range(game.targets.size):
            robots = _shared_out(game, tours)
            late = np.array([_late(game, tour) / n for tour, n in zip(tours, robots, strict=True)])
            worst = int(late.argmax())
            moved = _moved(tours, worst, late, robots, game, part)
            if moved is None:
                break
            other, tours[worst], taken = moved
            tours[other] = taken
        if late.max() >= least * (1 - _SAME):
            return tours
        least = late.max()


def _moved(
    tours: Sequence[_Order],
    worst: int,
    late: Float[np.ndarray, "tours"],
    robots: Sequence[int],
    game: Game,
    part: Int[np.ndarray, "targets"],
) -> tuple[int, _Order, _Order] | None:
    """Find the move of consecutive stops of the worst tour that makes both tours shortest."""
    between, here = game.between, tours[worst]
    best, least = None, late[worst] * (1 - _SAME)
    for size in (size for size in _MOVED if size < here.size):
        # The moved stops are the last ones, after each rotation.
        first, last = np.roll(here, size - 1), here
        before, after = np.roll(first, 1), np.roll(here, -1)
        inside = sum(
            (between[np.roll(here, k + 1), np.roll(here, k)] for k in range(size - 1)), 0.0
        )
        saved = between[before, first] + inside + between[last, after] - between[before, after]
        for other, tour in enumerate(tours):
            if other == worst or part[tour[0]] != part[here[0]]:
                continue
            there = np.roll(tour, -1)
            longer = between[np.ix_(tour, first)] + between[np.ix_(last, there)].T
            longer = longer - between[tour, there][:, None] + inside
            place = longer.argmin(axis=0)
            attack = np.minimum(game.attack[tour].min(), game.attack[first])
            now = tour_length(tour, between) + longer.min(axis=0)
            left = (tour_length(here, between) - saved) / (game.attack[here].min() * robots[worst])
            both = np.maximum(left, now / (attack * robots[other]))
            k = int(both.argmin())
            if both[k] < least:
                least = both[k]
                turned = np.roll(here, -(k + 1))
                stays, goes = turned[: here.size - size], turned[here.size - size :]
                at = int(place[k]) + 1
                best = other, stays, np.concatenate([tour[:at], goes, tour[at:]])
    return best


def _with_repeats(found: Rounds) -> Rounds:
    """Visit the targets with the largest risks several times in a tour, if this lowers the rank."""
    game = found.game
    if _is_uniform(game) or (found.evaluation.longest <= game.attack).all():
        return found
    for _ in range(_REPEATS):
        best = found
        for tour, order in enumerate(found.orders):
            if not 2 <= order.size <= _STOPS:
                continue
            risk = (found.evaluation.longest / game.attack)[order]
            for target in np.unique(order[risk >= risk.max() * (1 - _SAME)]).tolist():
                for place in range(order.size):
                    if target in (order[place - 1], order[place]):
                        continue
                    orders = [*found.orders]
                    orders[tour] = np.insert(order, place, target)
                    best = min(best, Rounds.of(game, orders, found.robots), key=lambda r: r.rank)
        if best is found:
            return found
        found = best
    return found
