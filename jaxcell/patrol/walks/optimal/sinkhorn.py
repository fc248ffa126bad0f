import numpy as np
import scipy.special
from jaxtyping import Float


_STEPS = 500
# Sums of flows that differ by at most this share of the total count as equal.
_ROUNDING = 1e-15
# Below this error, a step that does not improve the flows is due to rounding.
_CLOSE = 1e-9


def scale_to_stationary(
    weights: Float[np.ndarray, "vertices vertices"], share: Float[np.ndarray, "vertices"]
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the chain `p_ij = a_i w_ij b_j` with a given stationary distribution.

    This is Sinkhorn's problem for the flows `share_i p_ij`, whose rows and columns both sum to
    `share`. A positive weight whose flow must be 0 gets a probability that tends to 0.
    Each step is the better of a Sinkhorn step, which is slow if some flows almost vanish,
    and a Newton step on the same dual problem.
    """
    with np.errstate(divide="ignore"):
        kernel = np.log(weights)

    def columns(a: Float[np.ndarray, "vertices"]) -> Float[np.ndarray, "vertices"]:
        return np.log(share) - scipy.special.logsumexp(kernel + a[:, None], axis=0)

    def flows(a: Float[np.ndarray, "vertices"]) -> Float[np.ndarray, "vertices vertices"]:
        return np.exp(kernel + a[:, None] + columns(a))

    def off(flow: Float[np.ndarray, "vertices vertices"]) -> float:
        error = np.abs(flow.sum(axis=1) - share).sum()
        return float(error) if np.isfinite(error) else np.inf

    a = np.log(share)
    flow = flows(a)
    for _ in range(_STEPS):
        rows = flow.sum(axis=1)
        hessian = np.diag(rows) - (flow / share) @ flow.T
        # If starts share no end with other starts, adding a constant to their `a` has no effect.
        newton = a + np.linalg.lstsq(hessian, share - rows, rcond=1e-13)[0]
        with np.errstate(over="ignore", invalid="ignore"):
            candidates = [(to, flows(to)) for to in (newton, a - np.log(rows / share))]
        better, there = min(candidates, key=lambda candidate: off(candidate[1]))
        error = off(flow)
        if error < _ROUNDING or (error < _CLOSE and off(there) >= error):
            break
        a, flow = better, there
    if off(flow) > _CLOSE:
        raise RuntimeError(
            f"stationary: the flows could not be scaled to it; {off(flow):.3g} is missing"
        )
    return scipy.special.softmax(kernel + columns(a), axis=1)
