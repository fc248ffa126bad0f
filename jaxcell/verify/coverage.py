from typing import Literal

import numpy as np
import scipy.optimize
import scipy.sparse

from ..bounce import CELL_BY_CELL, CoveragePolicy, Motion
from ..mapping import SimpleMap
from ..space import CellSpace
from .bounce import compare_straight
from .comparison import Comparison, solve_transient


# Largest number of cells for which the shares of groups are compared.
_MAX_CELLS = 20_000
_CLOSE = 1e-8


def compare_coverage(
    policy: CoveragePolicy,
    error: float,
    reliability: float,
    *,
    weights: Literal["basin", "size"] = "basin",
    motion: Motion = CELL_BY_CELL,
) -> list[Comparison]:
    """Compare a mixture of bouncing policies with independent matrices and solvers.

    The other arguments are those from which [`jaxcell.bounce.coverage_policy`][] computed `policy`.
    """
    cells = policy.cells
    straight, images = compare_straight(cells, motion=motion)
    moved, ends, shares = [], [], []
    for i, bounce in enumerate(policy.bounce.tolist()):
        P = _matrix(cells, straight, bounce, error, reliability)
        value = np.asarray(policy.limiting[i].value)
        moved.append(float(np.abs(P.T @ value - value).sum()))
        group = np.asarray(policy.groups[i].group)
        if weights == "basin" and policy.groups[i].count > 1 and cells.size <= _MAX_CELLS:
            transient, chance = np.flatnonzero(group < 0), (group == 0).astype(float)
            if transient.size:
                chance[transient] = solve_transient(P, transient, P[transient] @ chance)
            ends.append(float(chance.mean()))
            shares.append(float(value[group == 0].sum()))
    what = "change of limiting distributions by a step, with independent sparse matrices"
    compared = [images, Comparison.close(what, moved, np.zeros(len(moved)), _CLOSE)]
    if ends:
        what = "share of the first group, by a sparse direct solve"
        compared.append(Comparison.close(what, shares, ends, _CLOSE))
    return [*compared, _nearest(policy)]


def _matrix(
    cells: CellSpace, straight: SimpleMap, bounce: float, error: float, reliability: float
) -> scipy.sparse.csr_array:
    """Build the transition matrix: steps straight ahead, and turns by `bounce` at walls.

    With the probability `1 - reliability`, a turn has an error of up to `error` radians.
    """
    image, bumped = np.asarray(straight.image), np.asarray(straight.bumped)
    spacing = 2 * np.pi / cells.directions
    turn, bins = round(bounce / spacing), round(error / spacing)
    goes, bumps = np.flatnonzero(~bumped), np.flatnonzero(bumped)
    rows, columns, shares = [goes], [image[goes]], [np.ones(goes.size)]
    for by in range(-bins, bins + 1):
        share = reliability if by == 0 else (1 - reliability) / (2 * bins)
        rows.append(bumps)
        columns.append((bumps + (turn + by) * cells.positions) % cells.size)
        shares.append(np.full(bumps.size, share))
    entries = np.concatenate(shares), (np.concatenate(rows), np.concatenate(columns))
    return scipy.sparse.csr_array(entries, shape=(cells.size,) * 2)


def _nearest(policy: CoveragePolicy) -> Comparison:
    """Compare the distance from the mixture to the target with non-negative least squares.

    An additional equation says that the weights sum to 1, but holds only approximately. The
    solution is the best mixture times a number of at most 1, so it is divided by its sum.
    """
    coverage, target = np.asarray(policy.coverage), np.asarray(policy.target)
    difference = (coverage - target).T
    wanted = np.append(np.zeros(len(difference)), 1.0)
    mixture, _ = scipy.optimize.nnls(np.vstack([difference, np.ones(len(coverage))]), wanted)
    distance = float(np.linalg.norm(difference @ (mixture / mixture.sum())))
    what = "distance of the mixture from the target, by non-negative least squares"
    # The duality gap is relative to the largest square.
    return Comparison.close(what, [policy.distance], [distance], 1e-7)
