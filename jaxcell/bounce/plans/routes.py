import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int, Integer, Shaped

from .roadmap import Roadmap


# Number of states that are relaxed at once: costs that fit the cache take half the time.
_BLOCK = 2**18


@dataclasses.dataclass(frozen=True, eq=False)
class Routes:
    """The cheapest routes from all walls to some entries (cells after bumps) of a [`Roadmap`][].

    A route is a path in a graph that has one layer per angle, with all walls in each layer. From
    wall `w` to entry `e` it starts in layer `layer[e, w]`. At a bump in layer `i`, the robot turns
    by angle `turn[e, i, w]`. In the exact search each turn leads to the layer of its angle, so the
    layer shows the angle of the last turn. In the layered search a route stays in one layer.
    """

    cost: Shaped[np.ndarray, "entries walls"]
    "Cost of each route, including the bump at the wall; -1 for no route."
    layer: Integer[np.ndarray, "entries walls"]
    turn: Integer[np.ndarray, "entries angles walls"]
    "Index of the angle to turn by at each wall in each layer; -1 for no route."

    @classmethod
    def joined(cls, parts: Sequence["Routes"]) -> "Routes":
        return cls(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))


def block_size(roadmap: Roadmap) -> int:
    """Choose the number of entries whose routes are computed together."""
    return max(16, _BLOCK // roadmap.turned.size)


def solve(roadmap: Roadmap, entries: Int[np.ndarray, "entries"]) -> Routes:
    """Find the cheapest routes to entries, by value iteration over all walls.

    The index -1 stands for no entry, and has no routes. An iteration looks one bump ahead from
    every wall in every layer, so there are as many iterations as the longest plan has bumps.

    NumPy was the fastest in measurements. For all pairs of 384 to 28,000 cells on two cores, the
    same iterations in JAX take 1 to 3 times as long, after 0.8 s of compilation for each new map,
    and Dijkstra's algorithm (scipy) on the same graph takes 1.5 to 3 times as long.
    """
    bump = _Bump.of(roadmap, entries)
    value, turn = _exact(bump) if roadmap.method == "exact" else _layered(bump)
    least = value.min(axis=0)
    cost = np.where(least < bump.never, least, bump.never.dtype.type(-1))
    turn = np.where(value < bump.never, turn, -1)
    return Routes(
        cost=np.ascontiguousarray(cost.T),
        layer=np.ascontiguousarray(value.argmin(axis=0).T, roadmap.small),
        turn=np.ascontiguousarray(np.moveaxis(turn, 2, 0), roadmap.small),
    )


def costs(
    roadmap: Roadmap,
    route_costs: Shaped[np.ndarray, "goals walls"],
    goals: Int[np.ndarray, "goals"],
) -> Shaped[np.ndarray, "cells goals"]:
    """Compute the costs of the cheapest plans from all cells to goals; -1 if there is no plan.

    `route_costs` are the costs of the routes to the entry of each goal, -1 for no route.
    """
    length = roadmap.length.astype(route_costs.dtype) * roadmap.number.type(roadmap.keep)
    past_entry = length[roadmap.entry[roadmap.entry_of[goals]]] - length[goals]
    # This cost is so far below 0 that no run to the wall makes it positive.
    never = -_never(roadmap.number)
    route_costs = np.where(route_costs < 0, never, route_costs + past_entry[:, None])
    result = np.ascontiguousarray(route_costs.T)[roadmap.wall]
    result += length[:, None]
    np.maximum(result, -1, out=result)
    cell, column = roadmap.straight(goals)
    result[cell, column] = length[cell] - length[goals[column]]
    return result


def _never(number: np.dtype) -> np.number:
    """Return the cost that represents no route; the sum of two such costs does not overflow."""
    return number.type(np.inf if number.kind == "f" else np.iinfo(number).max // 2)


@dataclasses.dataclass(frozen=True, eq=False)
class _Bump:
    """The next wall after each bump, and the costs of bumps. For speed, goals are the last axis."""

    onward: Int[np.ndarray, "angles walls"]
    "The wall of the next bump."
    price: Shaped[np.ndarray, "angles walls 1"]
    "Cost of a bump that keeps the angle, and of the run to the next wall."
    arrival: Shaped[np.ndarray, "angles walls goals"]
    """Cost of a bump that keeps the angle, and of the run to a goal; `never`, the cost of no route,
    if the run misses the goal."""
    surplus: np.number
    "Additional cost of a bump that changes the angle."
    never: np.number

    @classmethod
    def of(cls, roadmap: Roadmap, entries: Int[np.ndarray, "goals"]) -> "_Bump":
        goal = roadmap.entry[entries]
        number = roadmap.number
        keep, surplus = number.type(roadmap.keep), number.type(roadmap.change - roadmap.keep)
        run = roadmap.length[roadmap.turned][:, :, None]
        rest = (run - roadmap.length[goal]).astype(number)
        arrives = roadmap.runs_through(roadmap.turned[:, :, None], goal) & (entries >= 0)
        never = _never(number)
        return cls(
            onward=roadmap.wall[roadmap.turned],
            price=keep * (1 + run.astype(number)),
            arrival=np.where(arrives, keep * (1 + rest), never),
            surplus=surplus,
            never=never,
        )

    def run(
        self,
        k: int,
        value: Shaped[np.ndarray, "walls goals"],
        out: Shaped[np.ndarray, "walls goals"],
    ) -> None:
        """Write into `out` the total cost of a bump with angle `k` and of the route after it.

        `value` contains the costs of the routes from all walls.
        """
        # With mode "raise" NumPy copies the result again.
        np.take(value, self.onward[k], axis=0, out=out, mode="clip")
        np.add(out, self.price[k], out=out)
        np.minimum(out, self.arrival[k], out=out)


def _exact(bump: _Bump) -> tuple[Shaped[np.ndarray, "angles walls goals"], Int[np.ndarray, "..."]]:
    """Find the least cost to each goal and the best turn, for each previous angle and each wall."""
    value = np.full_like(bump.arrival, bump.never)
    after = np.empty_like(value)

    def look_ahead() -> None:
        for k in range(len(after)):
            bump.run(k, value[k], out=after[k])

    while True:
        look_ahead()
        changed = np.minimum(after.min(axis=0) + bump.surplus, bump.never)
        np.minimum(after, changed, out=after)
        if np.array_equal(after, value):
            break
        value, after = after, value
    look_ahead()
    kept = after <= after.min(axis=0) + bump.surplus
    angle = np.arange(len(after))[:, None, None]
    return value, np.where(kept, angle, after.argmin(axis=0))


def _layered(
    bump: _Bump,
) -> tuple[Shaped[np.ndarray, "angles walls goals"], Int[np.ndarray, "..."]]:
    """Find the least cost to each goal and the best turn, for each wall in each angle's graph."""
    value = np.full_like(bump.arrival, bump.never)
    turn = np.empty(value.shape, np.int64)
    after = np.empty_like(value)

    def look_ahead(i: int) -> None:
        for k in range(len(after)):
            bump.run(k, value[i], out=after[k])
            if k != i:
                after[k] += bump.surplus

    for i in range(len(value)):
        while True:
            look_ahead(i)
            best = np.minimum(after.min(axis=0), bump.never)
            if np.array_equal(best, value[i]):
                break
            value[i] = best
        turn[i] = after.argmin(axis=0)
    return value, turn
