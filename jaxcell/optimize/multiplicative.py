"""The weights with the least commute time, on graphs too large for a Hessian `[edges, edges]`."""

import numpy as np
from jaxtyping import Float

from ..base.process import one_blas_thread
from .resistance import Emphasis, Iterate, Laplacian, pseudo_inverse


# Number of edges that are processed at once, which limits the memory.
_ROWS = 256
# Largest number of inversions of the Laplacian.
_INVERSIONS = 300
# The least weight, which is positive so that its logarithm is finite.
_LEAST = 1e-100


@one_blas_thread()
def least_resistance(
    laplacian: Laplacian, problem: Emphasis, tolerance: float
) -> tuple[Iterate, int]:
    """Find weights of edges with the least sum of reciprocal eigenvalues of the Laplacian.

    Let `g_e = |X b_e|^2 / t_e` be the decrease of the sum per unit of weight, where `X` is the
    pseudo-inverse of the Laplacian, `b_e` the column of edge `e` in the incidence matrix, and `t_e`
    its duration. Then `sum_e g_e w_e^2 / u_e` bounds the sum at other weights `u` and equals the
    sum at `u = w`. The bound is least at weights in proportion to `w_e sqrt(g_e)`. If the tour then
    has less than its share, its weights are raised, and the other weights are lowered. Each step to
    these weights lowers the sum. Every two steps are extrapolated (Varadhan and Roland 2008), by a
    shorter length if the sum would increase.

    **Returns:** the weights with the smallest relative gap, and the number of inversions of the
    Laplacian.
    """
    durations = laplacian.durations
    best, count = Iterate(np.empty(0), None, np.inf, np.inf), 0

    def shared(weights: Float[np.ndarray, "edges"]) -> Float[np.ndarray, "edges"]:
        return problem.scaled(np.maximum(weights / weights.sum(), _LEAST))

    def step(weights: Float[np.ndarray, "edges"]) -> tuple[Float[np.ndarray, "edges"], float]:
        nonlocal best, count
        count += 1
        inverse = pseudo_inverse(laplacian.vertices, laplacian.edges, weights / durations)
        resistance, gain = float(np.trace(inverse)), np.empty(weights.size)
        for first in range(0, gain.size, _ROWS):
            tail, head = laplacian.edges[first : first + _ROWS].T
            columns = inverse[tail] - inverse[head]
            gain[first : first + _ROWS] = np.einsum("en,en->e", columns, columns)
        gain /= durations
        gap = max(0.0, 1 - resistance / problem.most(gain))
        if gap < best.gap:
            best = Iterate(weights, None, resistance, gap)
        return shared(weights * np.sqrt(gain)), resistance

    weights = shared(np.ones(durations.size))
    following, _ = step(weights)
    while best.gap > tolerance and count < _INVERSIONS:
        second, now = step(following)
        logs = [np.log(point) for point in (weights, following, second)]
        ahead, bend = logs[1] - logs[0], logs[2] - 2 * logs[1] + logs[0]
        length = np.sqrt(following @ ahead**2 / max(following @ bend**2, _LEAST))
        while length > 1:
            tried = shared(np.exp(logs[0] + 2 * length * ahead + length**2 * bend))
            after, resistance = step(tried)
            if resistance <= now or count >= _INVERSIONS:
                break
            length = (1 + length) / 2 if length > 1.5 else 0.0
        else:
            tried = second
            after, _ = step(tried)
        weights, following = tried, after
    return best, count
