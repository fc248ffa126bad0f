"""Linear constraints on the weights of a walk, and the weights that they allow."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from .graph import Graph


# Less room than this number, relative to the coefficients, counts as no room.
_NO_ROOM = 1e-7
# Rows with a smaller pivot count as linearly dependent.
_DEPENDENT = 1e-9
# Constraints with a smaller price count as constraints without effect.
_NO_PRICE = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Linear(Shown):
    """Bounds on a linear function of the weights of a walk, which sum to 1.

    At most a third of the steps along two edges of a triangle:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2], [2, 0]])
        >>> cap = optimize.Linear("cap", [1, 1, 0], upper=1 / 3)
        >>> optimize.minimum_commute(graph, constraints=[cap]).weights.round(6).tolist()
        [0.166667, 0.166667, 0.666667]
    """

    label: str
    "The name of the constraint in messages and results."
    coefficients: Any
    "The coefficient of each weight, stored as an array `[edges]`."
    lower: float | int = -math.inf
    upper: float | int = math.inf
    "The upper bound; if it equals the lower bound, the value of the function is fixed."

    def __post_init__(self) -> None:
        row, lower, upper = np.array(self.coefficients, np.float64), self.lower, self.upper
        if row.ndim != 1 or not np.isfinite(row).all() or not row.any():
            raise ValueError(f"{self.label}: expected finite coefficients, one per edge, not all 0")
        if not lower <= upper or lower == math.inf or upper == -math.inf:
            raise ValueError(
                f"{self.label}: expected a lower bound up to the upper one, got {lower:g} and "
                f"{upper:g}"
            )
        object.__setattr__(self, "coefficients", row)

    @classmethod
    def on_visits(
        cls,
        graph: Graph,
        label: str,
        coefficients: Any,
        lower: float | int = -math.inf,
        upper: float | int = math.inf,
    ) -> "Linear":
        """Bound a linear function of the shares of time at vertices.

        `coefficients` is an array `[vertices]`. In a walk with weights that sum to 1, the share of
        time at a vertex is half the sum of the weights of its edges.
        """
        of_ends = np.asarray(coefficients, np.float64)[graph.edges]
        return cls(label, of_ends.mean(axis=1), lower, upper)


@dataclasses.dataclass(frozen=True, eq=False)
class Room:
    """The set of weights that constraints allow: `sums' x = totals` and `x > 0`.

    `x` are the weights of the edges that may have weight, followed by the slacks of inequalities.
    Inequalities that all allowed weights meet with equality count as equalities, and constraints
    that follow from others are omitted.
    """

    used: Bool[np.ndarray, "edges"]
    "The edges that may have weight."
    sums: Float[np.ndarray, "numbers prices"]
    totals: Float[np.ndarray, "prices"]
    "The right-hand sides: the sum of all weights, then equalities, then inequalities."
    signs: Int[np.ndarray, "prices"]
    "For each equation, 1 for a lower bound, -1 for an upper bound, 0 for an equality."
    owner: Int[np.ndarray, "prices"]
    "For each equation, the index of its constraint, or -1 for the sum of all weights."
    units: Float[np.ndarray, "prices"]
    "The largest coefficient of each constraint. Constraints are divided by it."
    inside: Float[np.ndarray, "numbers"]
    "A point that satisfies all constraints."

    @property
    def edges(self) -> int:
        """The number of edges that may have weight."""
        return int(self.used.sum())

    def start(self, design: Any) -> Float[np.ndarray, "numbers"]:
        """Return a point far from all bounds."""
        return self.inside

    def first_prices(
        self, gain: Float[np.ndarray, "used"], numbers: Float[np.ndarray, "numbers"]
    ) -> Float[np.ndarray, "prices"]:
        """Return initial prices for the interior-point method, with positive dual slacks."""
        prices, spare = np.zeros(self.totals.size), self.signs != 0
        prices[spare] = -self.signs[spare] / (self.edges * numbers[self.edges :])
        prices[0] = 1.2 * np.abs(gain - self.sums[: self.edges] @ prices).max()
        return prices

    def prices_of(
        self, prices: Float[np.ndarray, "prices"], count: int
    ) -> Float[np.ndarray, "constraints"]:
        """Return the price of each of the first `count` constraints; 0 for one without effect."""
        owned = (self.owner >= 0) & (self.owner < count)
        # Without prices, `bincount` would return whole numbers.
        return np.bincount(self.owner[owned], np.abs(prices / self.units)[owned], count) * 1.0

    def most(self, gain: Float[np.ndarray, "used"], prices: Any) -> float:
        """Return an upper bound on `gain @ weights` over all allowed weights.

        Any prices give a bound, because those of the wrong sign are ignored. The bound is tight for
        the optimal prices of the linear program that maximises `gain @ weights`.
        """
        prices = np.where(self.signs * prices > 0, 0.0, prices)
        left = gain - self.sums[: self.edges] @ prices
        return float(prices @ self.totals + left.max())


def room(edges: int, constraints: Sequence[Linear]) -> Room:
    """Find the set of weights that constraints allow.

    One linear program finds a solution in which all weights and slacks that can be positive are
    positive. A second program finds a point far from all bounds.
    """
    for rule in constraints:
        if rule.coefficients.size != edges:
            raise ValueError(
                f"constraints: {rule.label} has {rule.coefficients.size} coefficients; expected "
                f"{edges}, one per edge"
            )
    rows, bounds, signs, owner, units = _sides(edges, constraints)
    unequal = np.flatnonzero(signs)
    spare = np.diag(-signs.astype(float))[unequal]
    sums = np.concatenate([rows.T, spare])
    # Numbers x = (z + v) / t, with z = 1 for as many as possible: all x > 0 are 1 / t or more.
    count = len(sums)
    program = scipy.optimize.linprog(
        -np.append(np.ones(count), np.zeros(count + 1)),
        A_eq=np.column_stack([sums.T, sums.T, -bounds]),
        b_eq=np.zeros(bounds.size),
        bounds=[*[(0, 1)] * count, *[(0, None)] * count, (1, 1 / _NO_ROOM)],
    )
    if program.x is None:
        raise RuntimeError(f"constraints: {_contradiction(edges, constraints)}")
    has_room = program.x[:count] > 0.5
    used = has_room[:edges]
    fixed = np.setdiff1d(np.arange(bounds.size), unequal[has_room[edges:]])
    fixed = fixed[_independent(rows[fixed][:, used])]
    order = np.append(fixed, unequal[has_room[edges:]])
    sums, bounds, signs = sums[has_room][:, order], bounds[order], signs[order]
    signs[: fixed.size] = 0
    # A point far from all bounds: x = y + r, with y >= 0 and the largest possible number r.
    count = len(sums)
    inside = scipy.optimize.linprog(
        -np.append(np.zeros(count), 1.0),
        A_eq=np.column_stack([sums.T, sums.sum(axis=0)]),
        b_eq=bounds,
    ).x
    if inside is None or not inside[-1] > 0:
        raise RuntimeError("constraints: the room that they leave is lost in rounding")
    inside = inside[:-1] + inside[-1]
    return Room(used, sums, bounds, signs, owner[order], units[order], inside)


class _Sides(NamedTuple):
    """The sum of weights and the bounds of constraints, as rows scaled to a largest entry of 1."""

    rows: Float[np.ndarray, "sides edges"]
    bounds: Float[np.ndarray, "sides"]
    signs: Int[np.ndarray, "sides"]
    owner: Int[np.ndarray, "sides"]
    units: Float[np.ndarray, "sides"]


def _sides(edges: int, constraints: Sequence[Linear]) -> _Sides:
    rows = [(np.ones(edges), 1.0, 0, -1, 1.0)]
    for number, rule in enumerate(constraints):
        unit = float(np.abs(rule.coefficients).max())
        sides = [(1, rule.lower), (-1, rule.upper)]
        for sign, bound in sides if rule.lower < rule.upper else [(0, rule.lower)]:
            if math.isfinite(bound):
                rows.append((rule.coefficients / unit, bound / unit, sign, number, unit))
    return _Sides(*map(np.array, zip(*rows, strict=True)))


def _independent(rows: Float[np.ndarray, "rows edges"]) -> Int[np.ndarray, "independent"]:
    """Choose linearly independent rows, including the first row."""
    first = rows[0] / np.linalg.norm(rows[0])
    rest = (rows - np.outer(rows @ first, first))[1:]
    if not len(rest):
        return np.array([0])
    _, triangle, order = scipy.linalg.qr(rest.T, mode="economic", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    return np.append(0, 1 + np.sort(order[: (pivots > _DEPENDENT).sum()]))


def _contradiction(edges: int, constraints: Sequence[Linear]) -> str:
    """Describe a smallest set of constraints that contradict each other.

    Constraints are left out one by one as long as the others still contradict each other.
    """
    price = _least_violation(edges, constraints)[1]
    kept = [rule for rule, paid in zip(constraints, price, strict=True) if paid > _NO_PRICE]
    for rule in list(kept):
        others = [other for other in kept if other is not rule]
        if others and _least_violation(edges, others)[0] > _NO_ROOM:
            kept = others
    if len(kept) == 1:
        return f"no weights meet {kept[0].label}"
    return f"these contradict each other: {', '.join(rule.label for rule in kept)}"


def _least_violation(
    edges: int, constraints: Sequence[Linear]
) -> tuple[float, Float[np.ndarray, "constraints"]]:
    """Compute the least sum of violations of bounds, and the shadow price of each constraint."""
    total, *_ = sides = _sides(edges, constraints)
    both = np.concatenate([np.flatnonzero(sides.signs >= 0), np.flatnonzero(sides.signs <= 0)])
    both = both[sides.owner[both] >= 0]
    lower = np.append(np.ones((sides.signs >= 0).sum() - 1), -np.ones((sides.signs <= 0).sum() - 1))
    program = scipy.optimize.linprog(
        np.append(np.zeros(edges), np.ones(both.size)),
        A_ub=np.concatenate([-lower[:, None] * sides.rows[both], -np.eye(both.size)], axis=1),
        b_ub=-lower * sides.bounds[both],
        A_eq=np.append(total[0], np.zeros(both.size))[None],
        b_eq=[1.0],
    )
    price = np.bincount(sides.owner[both], -program.ineqlin.marginals, len(constraints))
    return float(program.fun), price
