import numpy as np
import scipy.linalg
from jaxtyping import Float


def eliminate(
    step: Float[np.ndarray, "rows rows"],
    leaving: Float[np.ndarray, "rows"],
    right: Float[np.ndarray, "rows columns"],
    *,
    adjoint: bool = False,
) -> Float[np.ndarray, "rows columns"]:
    """Solve `x = right + Q x`, or `x = right + Q' x`, without a subtraction.

    States are taken out one after the other, as Grassmann, Taksar and Heyman (1985) do: what a
    state does not keep is summed from where it goes, not subtracted from 1. So every number has
    nearly all its digits, even for a chain that leaves its cells once in 10^20 steps, where other
    factorisations give noise. It is dense, and takes time with the third power of the rows.

    **Arguments:**

    - `step`: the matrix Q, with nothing negative; it is overwritten.
    - `leaving`: the probability of leaving from each row, which 1 less its sum would give without
        its digits.
    - `right`: what is added, not negative.
    - `adjoint`: whether to solve with the transposed matrix.
    """
    leaving = leaving.copy()
    on = np.empty(leaving.size)
    for k in range(leaving.size - 1, -1, -1):
        on[k] = leaving[k] + step[k, :k].sum()
        share = step[:k, k] / on[k]
        step[:k, :k] += share[:, None] * step[k, :k]
        leaving[:k] += share * leaving[k]
    # I - Q is the upper triangle times the lower one. Substitution in them only adds.
    upper, lower = -step / on, -step
    np.fill_diagonal(lower, on)
    order = [(upper, False), (lower, True)]
    x = right
    for triangle, is_lower in reversed(order) if adjoint else order:
        x = scipy.linalg.solve_triangular(
            triangle, x, lower=is_lower, unit_diagonal=not is_lower, trans=int(adjoint)
        )
    return x
