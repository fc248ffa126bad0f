"""Linear constraints on the weights of a walk, and what they leave of the possible weights."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Float, Int

from .graph import Graph


# Room that is less, relative to the coefficients, counts as none.
_NO_ROOM = 1e-7
# Of a pivot: rows that others imply.
_DEPENDENT = 1e-9
# Of a price: a constraint that does not matter.
_NO_PRICE = 1e-9


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Linear:
    """Bounds on a linear function of the weights of a walk, which sum to 1.

    At most a third of the steps along two edges of a triangle:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2], [2, 0]])
        >>> cap = optimize.Linear("cap", [1, 1, 0], upper=1 / 3)
        >>> optimize.minimum_commute(graph, constraints=[cap]).weights.round(6).tolist()
        [0.166667, 0.166667, 0.666667]
    """

    label: str
    "What messages and results call it."
    coefficients: Float[np.ndarray, "edges"]
    lower: float = -math.inf
    upper: float = math.inf

    def __init__(
        self,
        label: str,
        coefficients: Any,
        lower: float | int = -math.inf,
        upper: float | int = math.inf,
    ) -> None:
        """**Arguments:**

        - `label`: its name.
        - `coefficients`: array `[edges]`.
        - `lower`, `upper`: the bounds; where they are equal, the function has that value.

        **Raises:** `ValueError` for coefficients that are not finite or all 0, and for bounds that
        leave no number.
        """
        row = np.array(coefficients, np.float64)
        if row.ndim != 1 or not np.isfinite(row).all() or not row.any():
            raise ValueError(f"{label}: expected finite coefficients, one an edge, and not all 0")
        if not lower <= upper or lower == math.inf or upper == -math.inf:
            raise ValueError(
                f"{label}: expected a lower bound up to the upper one, got {lower:g} and {upper:g}"
            )
        object.__setattr__(self, "label", label)
        object.__setattr__(self, "coefficients", row)
        object.__setattr__(self, "lower", float(lower))
        object.__setattr__(self, "upper", float(upper))

    @classmethod
    def on_visits(
        cls,
        graph: Graph,
        label: str,
        coefficients: Any,
        lower: float | int = -math.inf,
        upper: float | int = math.inf,
    ) -> "Linear":
        """Bound a linear function of the shares of time at the vertices, array `[vertices]`.

        A walk with weights `w` that sum to 1 is at a vertex for half the sum of those of its edges.
        """
        given = np.asarray(coefficients, np.float64)
        return cls(label, given[graph.edges].mean(axis=1), lower, upper)


@dataclasses.dataclass(frozen=True, eq=False)
class Room:
    """What constraints leave of the weights: `sums' x = totals` and `x > 0`.

    The weights of the edges that may have any come first in `x`; what inequalities have to spare
    follows. Constraints that leave no room are equalities here, and those that others imply are
    left out.
    """

    used: Bool[np.ndarray, "edges"]
    "The edges that may have weight."
    sums: Float[np.ndarray, "numbers prices"]
    totals: Float[np.ndarray, "prices"]
    "That of all weights first, then equalities, then inequalities."
    signs: Int[np.ndarray, "prices"]
    "1 for a lower bound, -1 for an upper one, 0 for an equality."
    owner: Int[np.ndarray, "prices"]
    "The constraint that each belongs to; -1 for the sum of all weights."
    units: Float[np.ndarray, "prices"]
    "The largest coefficient of that constraint, by which it is divided."
    inside: Float[np.ndarray, "numbers"]
    "Numbers that meet all of that."

    @property
    def edges(self) -> int:
        """How many weights there are."""
        return int(self.used.sum())

    @property
    def live(self) -> Bool[np.ndarray, "numbers"]:
        """All numbers may be positive."""
        return np.ones(len(self.sums), bool)

    def start(self, design: Any) -> Float[np.ndarray, "numbers"]:
        """Numbers far from all bounds."""
        return self.inside

    def first_prices(
        self, gain: Float[np.ndarray, "used"], numbers: Float[np.ndarray, "numbers"]
    ) -> Float[np.ndarray, "prices"]:
        """Prices that leave a pressure on each number that keeps it positive."""
        prices, spare = np.zeros(self.totals.size), self.signs != 0
        prices[spare] = -self.signs[spare] / (self.edges * numbers[self.edges :])
        prices[0] = 1.2 * np.abs(gain - self.sums[: self.edges] @ prices).max()
        return prices

    def most(self, gain: Float[np.ndarray, "used"], prices: Float[np.ndarray, "prices"]) -> float:
        """A bound on `gain @ weights` for all weights that the constraints leave.

        It holds for any prices, because those of the wrong sign do not count, and is close for
        those of the linear program.
        """
        prices = np.where(self.signs * prices > 0, 0.0, prices)
        left = gain - self.sums[: self.edges] @ prices
        return float(prices @ self.totals + left.max())


def room(edges: int, constraints: Sequence[Linear]) -> Room:
    """Find what constraints leave of the weights.

    One linear program finds what has room at all: numbers that are `t` times as large can be 1 or
    more, for a `t` that is large enough. A second one finds numbers far from 0.

    **Raises:** `RuntimeError` that names constraints that contradict each other; `ValueError` for
    one on another number of edges.
    """
    for one in constraints:
        if one.coefficients.size != edges:
            raise ValueError(
                f"constraints: {one.label} has {one.coefficients.size} coefficients; expected "
                f"{edges}, one an edge"
            )
    rows, bounds, signs, owner, units = _sides(edges, constraints)
    unequal = np.flatnonzero(signs)
    spare = np.diag(-signs.astype(float))[unequal]
    sums = np.concatenate([rows.T, spare])
    # Numbers x = (z + v) / t, as many as can with z = 1.
    count = len(sums)
    found = scipy.optimize.linprog(
        -np.append(np.ones(count), np.zeros(count + 1)),
        A_eq=np.column_stack([sums.T, sums.T, -bounds]),
        b_eq=np.zeros(bounds.size),
        bounds=[*[(0, 1)] * count, *[(0, None)] * count, (1, 1 / _NO_ROOM)],
    )
    if found.x is None:
        raise RuntimeError(f"constraints: {_contradiction(edges, constraints)}")
    has_room = found.x[:count] > 0.5
    used = has_room[:edges]
    fixed = np.setdiff1d(np.arange(bounds.size), unequal[has_room[edges:]])
    fixed = fixed[_independent(rows[fixed][:, used])]
    order = np.append(fixed, unequal[has_room[edges:]])
    sums, bounds, signs = sums[has_room][:, order], bounds[order], signs[order]
    signs[: fixed.size] = 0
    # Far from all bounds: x = y + r, with a number r that is as large as can be.
    count = len(sums)
    inside = scipy.optimize.linprog(
        -np.append(np.zeros(count), 1.0),
        A_eq=np.column_stack([sums.T, sums.sum(axis=0)]),
        b_eq=bounds,
    ).x
    if inside is None or not inside[-1] > 0:
        raise RuntimeError("constraints: what room they leave is lost in rounding")
    inside = inside[:-1] + inside[-1]
    return Room(used, sums, bounds, signs, owner[order], units[order], inside)


class _Sides(NamedTuple):
    """The sum of all weights and the bounds of constraints, as rows with coefficients up to 1."""

    rows: Float[np.ndarray, "sides edges"]
    bounds: Float[np.ndarray, "sides"]
    signs: Int[np.ndarray, "sides"]
    owner: Int[np.ndarray, "sides"]
    units: Float[np.ndarray, "sides"]


def _sides(edges: int, constraints: Sequence[Linear]) -> _Sides:
    found = [(np.ones(edges), 1.0, 0, -1, 1.0)]
    for number, one in enumerate(constraints):
        unit = float(np.abs(one.coefficients).max())
        sides = [(1, one.lower), (-1, one.upper)]
        for sign, bound in sides if one.lower < one.upper else [(0, one.lower)]:
            if math.isfinite(bound):
                found.append((one.coefficients / unit, bound / unit, sign, number, unit))
    return _Sides(*map(np.array, zip(*found, strict=True)))


def _independent(rows: Float[np.ndarray, "rows edges"]) -> Int[np.ndarray, "some"]:
    """Rows that are linearly independent, the first among them."""
    first = rows[0] / np.linalg.norm(rows[0])
    rest = (rows - np.outer(rows @ first, first))[1:]
    if not len(rest):
        return np.array([0])
    _, triangle, order = scipy.linalg.qr(rest.T, mode="economic", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    return np.append(0, 1 + np.sort(order[: (pivots > _DEPENDENT).sum()]))


def _contradiction(edges: int, constraints: Sequence[Linear]) -> str:
    """Say which constraints contradict each other, of which none can be left out.

    Where the least sum of what must give way is positive, the constraints with a price prove it. Of
    these, one after the other is left out if the others still contradict.
    """
    price = _give_way(edges, constraints)[1]
    kept = [one for one, paid in zip(constraints, price, strict=True) if paid > _NO_PRICE]
    for one in list(kept):
        others = [other for other in kept if other is not one]
        if others and _give_way(edges, others)[0] > _NO_ROOM:
            kept = others
    if len(kept) == 1:
        return f"no weights meet {kept[0].label}"
    return f"these contradict each other: {', '.join(one.label for one in kept)}"


def _give_way(
    edges: int, constraints: Sequence[Linear]
) -> tuple[float, Float[np.ndarray, "constraints"]]:
    """How much bounds must give way in sum, and what those of each constraint cost."""
    total, *_ = sides = _sides(edges, constraints)
    both = np.concatenate([np.flatnonzero(sides.signs >= 0), np.flatnonzero(sides.signs <= 0)])
    both = both[sides.owner[both] >= 0]
    lower = np.append(np.ones((sides.signs >= 0).sum() - 1), -np.ones((sides.signs <= 0).sum() - 1))
    found = scipy.optimize.linprog(
        np.append(np.zeros(edges), np.ones(both.size)),
        A_ub=np.concatenate([-lower[:, None] * sides.rows[both], -np.eye(both.size)], axis=1),
        b_ub=-lower * sides.bounds[both],
        A_eq=np.append(total[0], np.zeros(both.size))[None],
        b_eq=[1.0],
    )
    price = np.bincount(sides.owner[both], -found.ineqlin.marginals, len(constraints))
    return float(found.fun), price
