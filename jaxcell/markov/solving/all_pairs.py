"""The expected number of steps between all pairs of states, without subtractions."""

import math

import numpy as np
from jaxtyping import Float

from ...base.process import one_blas_thread
from .elimination import take_out


@one_blas_thread()
@np.errstate(all="ignore")
def times_between_all(
    step: Float[np.ndarray, "states states"],
) -> tuple[Float[np.ndarray, "states states"], float]:
    """Compute the expected number of steps from each state to each other state.

    The second half of the states is eliminated, which leaves a chain on the first half, whose steps
    last longer; the times to its states follow in the same way, and give the times from the other
    half to them. The times to the second half follow from eliminating the first. So the work grows
    with the cube of the number of states, and only positive numbers are added and multiplied, which
    keeps nearly all digits even if the chain takes 10^20 steps.

    `step` is an irreducible transition matrix, whose diagonal has no effect. Returns the times, a
    row per start, and a bound on their relative errors.
    """
    times, error = _between(step, np.ones((len(step), 1)))
    return times, error if np.isfinite(times).all() else math.inf


def _between(
    step: Float[np.ndarray, "states states"], lasts: Float[np.ndarray, "states 1"]
) -> tuple[Float[np.ndarray, "states states"], float]:
    """Compute the times between states from which a step `lasts` a mean time."""
    size = len(step)
    times, largest = np.zeros((size, size)), 0.0
    if size == 1:
        return times, largest
    states = np.arange(size)
    for kept, order in ((-(-size // 2), states), (size // 2, states[::-1])):
        front, x = step[np.ix_(order, order)], lasts[order]
        factor = take_out(front, np.zeros(size), kept)
        factor.inward(x, adjoint=False)
        times_to = np.tile(x, kept)
        times_to[:kept], error = _between(front[:kept, :kept], x[:kept])
        factor.outward(times_to, adjoint=False)
        times[np.ix_(order, order[:kept])] = times_to
        largest = max(largest, error + factor.error)
    return times, largest
