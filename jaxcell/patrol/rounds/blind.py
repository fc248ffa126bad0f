"""The least risk of all schedules, if the adversary comes at a random time, in small games."""

import functools
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.sparse
from jaxtyping import Float, Int

from .game import Game
from .joint import Clock, State, clock_of, routes_along
from .route import Route


# Largest number of moves between states in the linear program, and the least share of one.
_MOVES, _LITTLE = 12_000, 1e-9


class _Flow(NamedTuple):
    """The moves between states in a unit of time, and their shares at the least risk."""

    clock: Clock
    states: list[State]
    begins: Int[np.ndarray, "moves"]
    ends: Int[np.ndarray, "moves"]
    orders: list[tuple[int, ...]]
    share: Float[np.ndarray, "moves"]
    risk: float

    def cycles(self) -> list[list[int]]:
        """Divide the flow into cycles of moves."""
        left, found = self.share.copy(), list[list[int]]()
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
            found.append(cycle)
        return found


@functools.lru_cache(maxsize=4)
def _least_flow(game: Game) -> _Flow | None:
    """Solve the linear program of `least_risk`."""
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
    `safe_routes`, whose sum into a state is that out of it. The risk is the largest value of a
    target times the share of moments at which an attack begins that succeeds.

    **Returns:** the risk, or `None` if times have no common unit, or there are too many moves.
    """
    return None if (flow := _least_flow(game)) is None else flow.risk


def blind_schedules(game: Game) -> list[tuple[Route, ...]]:
    """Return the cycles of `least_risk`, whose mixture has this risk; none if it is `None`."""
    if (flow := _least_flow(game)) is None:
        return []
    schedules = []
    for cycle in flow.cycles():
        ends = [(flow.states[flow.ends[move]], flow.orders[move]) for move in cycle]
        schedules.append(routes_along(game, flow.clock, [ends[-1], *ends]))
    return schedules
