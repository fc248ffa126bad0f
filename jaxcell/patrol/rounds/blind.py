"""The least risk of all schedules, if the adversary comes at a random time, in small games."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Float, Int

from .evaluation import evaluate_followed
from .game import Game
from .joint import Clock, State, clock_of, routes_along
from .route import Route


# Largest number of moves between states in the linear program, and of moves in a schedule.
_MOVES, _LONGEST = 12_000, 4000
# Numbers of times that the cycle with the least share is repeated, and the least share of one.
_REPEATS, _LEAST = (*range(1, 13), 20, 50, 100, 200, 500, 1000), 1e-3
# Least flow; and relative difference below which risks are equal.
_LITTLE, _SAME = 1e-9, 1e-7


class _Flow(NamedTuple):
    """The moves between states in a unit of time, and their shares at the least risk."""

    clock: Clock
    states: list[State]
    begins: Int[np.ndarray, "moves"]
    ends: Int[np.ndarray, "moves"]
    orders: list[tuple[int, ...]]
    share: Float[np.ndarray, "moves"]
    risk: float

    def cycles(self) -> list[tuple[float, list[int]]]:
        """Divide the flow into cycles of moves, each with a share per move."""
        left, found = self.share.copy(), []
        out = np.split(np.arange(left.size), np.flatnonzero(np.diff(self.begins)) + 1)
        while left.max() > _LITTLE:
            move, path, at = int(left.argmax()), list[int](), dict[int, int]()
            while (state := int(self.begins[move])) not in at:
                at[state] = len(path)
                path.append(move)
                after = out[self.ends[move]]
                move = int(after[left[after].argmax()])
            cycle = path[at[state] :]
            share = float(left[cycle].min())
            if share <= _LITTLE:
                break
            left[cycle] -= share
            found.append((share, cycle))
        return found

    def joined(self, cycles: Sequence[list[int]], repeats: Sequence[int]) -> list[int]:
        """Repeat the first cycle, and each other one where the fewest moves lead there and back."""
        number = np.arange(1.0, self.begins.size + 1)
        shape = (len(self.states),) * 2
        moves = scipy.sparse.csr_array((number, (self.begins, self.ends)), shape=shape)

        def ways(from_: Int[np.ndarray, "_"]) -> tuple[np.ndarray, np.ndarray]:
            return scipy.sparse.csgraph.dijkstra(
                moves, indices=from_, unweighted=True, return_predecessors=True
            )

        def followed(before: Int[np.ndarray, "states"], end: int) -> list[int]:
            way = []
            while before[end] >= 0:
                way.append(int(moves[before[end], end]) - 1)
                end = int(before[end])
            return way[::-1]

        joined = cycles[0] * repeats[0]
        for cycle, times in zip(cycles[1:], repeats[1:], strict=True):
            here, inside = np.unique(self.begins[joined]), self.begins[cycle]
            (there, before), (back, after) = ways(here), ways(inside)
            moved = there[:, inside] + back[:, here].T
            i, k = divmod(int(moved.argmin()), len(cycle))
            at = int(np.argmax(self.begins[joined] == here[i]))
            turned = (cycle[k:] + cycle[:k]) * times
            way, home = followed(before[i], int(inside[k])), followed(after[k], int(here[i]))
            joined = joined[:at] + way + turned + home + joined[at:]
        return joined


@functools.lru_cache(maxsize=4)
def _least_flow(game: Game) -> _Flow | None:
    """Solve the linear program of [`least_risk`][]."""
    if game.components[0] > 1 or (clock := clock_of(game)) is None:
        return None
    attack = game.attack / clock.unit
    whole = np.ceil(attack * (1 - _LITTLE)).astype(int)
    clock = clock._replace(attack=tuple(whole.tolist()))
    after: dict[State, list[tuple[State, tuple[int, ...]]]] = {}
    stack, count = [next(clock.starts())], 0
    while stack:
        if (state := stack.pop()) not in after:
            after[state] = [*clock.after(state)]
            stack += [there for there, _ in after[state]]
            count += len(after[state])
            if count > _MOVES:
                return None
    number = {state: k for k, state in enumerate(after)}
    begins = np.repeat(np.arange(len(after)), [len(each) for each in after.values()])
    ends = np.array([number[there] for each in after.values() for there, _ in each])
    # The share of the next unit of time in which an attack is over that began at the last visit.
    late = np.clip(whole + 1 - attack - np.array([left for _, left in after]), 0, 1)[begins]
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
    orders = [order for each in after.values() for _, order in each]
    return _Flow(clock, [*after], begins, ends, orders, found.x[:-1], float(found.fun))


def least_risk(game: Game) -> float | None:
    """Compute the least risk of all strategies for an adversary who comes at a random time.

    The variables of a linear program are the shares of time for moves between the states of
    [`safe_routes`][], whose sum into a state is that out of it. The risk is the largest value of a
    target times the share of moments at which an attack begins that succeeds.

    **Returns:** the risk, or `None` if times have no common unit, or there are too many moves.
    """
    return None if (flow := _least_flow(game)) is None else flow.risk


def blind_routes(game: Game, loss: float) -> tuple[Route, ...] | None:
    """Follow the moves of [`least_risk`][], each cycle of them for its share of the time.

    Where cycles have no state in common, walks between them increase the risk.

    **Returns:** routes with the least risk, if there are any with a period of up to 4,000 moves;
    else the shortest whose risk exceeds it by at most `loss`, or those with the least. `None` as in
    `least_risk`.
    """
    if (flow := _least_flow(game)) is None:
        return None
    kept = [(share, cycle) for share, cycle in flow.cycles() if share * len(cycle) > _LEAST]
    shares, cycles = np.array([share for share, _ in kept]), [cycle for _, cycle in kept]
    best, least = None, np.inf
    for more in _REPEATS:
        repeats = np.rint(more * shares / shares.min()).astype(int).tolist()
        if best and np.dot(repeats, [*map(len, cycles)]) > _LONGEST:
            break
        joined = flow.joined(cycles, repeats)
        ends = [(flow.states[flow.ends[move]], flow.orders[move]) for move in joined]
        routes = routes_along(game, flow.clock, [ends[-1], *ends])
        risk = float(evaluate_followed(game, routes).risk(game).max())
        if risk <= flow.risk + _SAME * game.value.max():
            return routes
        if risk < least and least > flow.risk + loss:
            best, least = routes, risk
    return best
