from typing import Literal

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from ..bounce import CoveragePolicy, bounce_map
from ..bounce.dynamics import Collision
from ..mapping import SimpleMap
from ..space import CellSpace
from .bounce import compare_images
from .comparison import Comparison


# Of the system that is solved for where a robot ends.
_MOST_CELLS = 20_000
_CLOSE = 1e-8


def compare_coverage(
    cells: CellSpace,
    policy: CoveragePolicy,
    bounces: Float[np.ndarray, "angles"],
    error: float,
    reliability: float,
    *,
    weights: Literal["basin", "size"] = "basin",
    step: float | None = None,
    collision: Collision = "swept",
) -> list[Comparison]:
    """A mixture of bouncing policies against matrices made anew and general-purpose solvers.

    **Arguments:**

    - `cells`: the cells of a map.
    - `policy`: the mixture.
    - `bounces`: its angles, in radians.
    - `error`, `reliability`, `weights`, `step`, `collision`: as for
        [`jaxcell.bounce.coverage_policy`][].
    """
    straight = bounce_map(cells, 0.0, step=step, collision=collision)
    found = [compare_images(cells, straight, 0.0, step=step, collision=collision)]
    moved, ends, shares = [], [], []
    for i, bounce in enumerate(np.asarray(bounces).tolist()):
        P = _matrix(cells, straight, bounce, error, reliability)
        value = np.asarray(policy.limiting[i].value)
        moved.append(float(np.abs(P.T @ value - value).sum()))
        group = np.asarray(policy.groups[i].group)
        if weights == "basin" and policy.groups[i].count > 1 and cells.size <= _MOST_CELLS:
            # Where they end is told by the last column, for the first of the groups.
            ends.append(_ending(P, group))
            shares.append(float(value[group == 0].sum()))
    zero = np.zeros(len(moved))
    what = "what a step changes of limiting distributions, by a sparse matrix made anew"
    found.append(Comparison.close(what, moved, zero, _CLOSE))
    if ends:
        what = "the share of the first group, by a sparse direct solve"
        found.append(Comparison.close(what, shares, ends, _CLOSE))
    return [*found, _nearest(policy)]


def _matrix(
    cells: CellSpace, straight: SimpleMap, bounce: float, error: float, reliability: float
) -> scipy.sparse.csr_array:
    """The chain: straight on, or at a wall to any of the turns."""
    image, bumped = np.asarray(straight.image), np.asarray(straight.bumped)
    spacing = 2 * np.pi / cells.directions
    turn, bins = round(bounce / spacing), round(error / spacing)
    goes, bumps = np.flatnonzero(~bumped), np.flatnonzero(bumped)
    tails, heads, shares = [goes], [image[goes]], [np.ones(goes.size)]
    for by in range(-bins, bins + 1):
        share = reliability if by == 0 else (1 - reliability) / (2 * bins)
        tails.append(bumps)
        heads.append((bumps + (turn + by) * cells.positions) % cells.size)
        shares.append(np.full(bumps.size, share))
    ways = (np.concatenate(tails), np.concatenate(heads))
    return scipy.sparse.csr_array((np.concatenate(shares), ways), shape=(cells.size,) * 2)


def _ending(P: scipy.sparse.csr_array, group: np.ndarray) -> float:
    """The probability of ending in group 0 from a cell at random."""
    transient = np.flatnonzero(group < 0)
    chance = (group == 0).astype(float)
    if transient.size:
        Q = P[transient][:, transient]
        into = P[transient] @ chance
        system = (scipy.sparse.eye_array(transient.size) - Q).tocsc()
        chance[transient] = scipy.sparse.linalg.spsolve(system, into)
    return float(chance.mean())


def _nearest(policy: CoveragePolicy) -> Comparison:
    """The distance of the best mixture, by non-negative least squares.

    With one more row that asks for the sum 1, the solution is the best mixture but for its scale:
    for every scale the same mixture is best.
    """
    coverage, target = np.asarray(policy.coverage), np.asarray(policy.target)
    difference = (coverage - target).T
    asked = np.append(np.zeros(len(difference)), 1.0)
    found, _ = scipy.optimize.nnls(np.vstack([difference, np.ones(len(coverage))]), asked)
    distance = float(np.linalg.norm(difference @ (found / found.sum())))
    what = "distance of the mixture from the target, by non-negative least squares"
    # The gap is that of squares, relative to the largest.
    return Comparison.close(what, [policy.distance], [distance], 1e-7)
