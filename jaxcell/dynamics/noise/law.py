import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Complex, Float

from ...markov.solving.solve import factored, solve_signed
from ...markov.transient import Transient


# Largest number of modes, and the relative length of a vector that is rounding.
_MODES, _ROUNDING = 24, 1e-13
# Largest number of cells for which the inverse matrix is computed, by one elimination.
_DENSE = 400
# Largest number of cells of a map, whose factors are not sparse, that is factored.
_FACTORED = 10_000
# Expected number of steps below which a factorisation keeps seven digits.
_LONG = 1e9
_HALVINGS = 100


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """The law of the time until a chain leaves a transient part, as a sum of exponentials.

    The probability of being in the part after `n` steps is the sum of `share * ratio^n` or, if each
    step has an exponential duration, of `share * exp(-n rate)`. The modes are those of the inverse
    matrix in its Krylov space (Arnoldi 1951), whose slowest modes are exact up to rounding.
    """

    span: Complex[np.ndarray, "modes"]
    "The sum over time of each mode, in steps."
    share: Complex[np.ndarray, "modes"]
    continuous: bool
    quasi: Float[np.ndarray, "part"]
    "The quasi-stationary distribution: that of the place, if the chain stays in the part for long."

    @classmethod
    def of(
        cls,
        start: Float[np.ndarray, "part"],
        visits: Callable[[np.ndarray], np.ndarray],
        longest: float,
        continuous: bool,
    ) -> "tuple[Law, Law]":
        """Find the law for a start, and a law with two thirds of the modes, which shows its error.

        `start` are probabilities, which sum to less than 1 if the chain has left at once. `visits`
        is the function of [`visits_of`][], and `longest` the largest expected number of steps.
        """
        modes = min(_MODES, start.size)
        basis, block = np.zeros((modes + 1, start.size)), np.zeros((modes + 1, modes))
        length = np.linalg.norm(start)
        basis[0] = start / length
        used, rough = modes, max(1, 2 * modes // 3)
        for k in range(modes):
            # Squares of longer vectors may be too large for 64 bits.
            vector = visits(basis[k]) / longest
            size = np.linalg.norm(vector)
            # Twice, because rounding leaves a part of earlier vectors.
            for _ in range(2):
                along = basis[: k + 1] @ vector
                block[: k + 1, k] += along
                vector = vector - along @ basis[: k + 1]
            block[k + 1, k] = np.linalg.norm(vector)
            if block[k + 1, k] <= _ROUNDING * size:
                # The modes so far are complete, up to rounding.
                used = rough = k + 1
                break
            basis[k + 1] = vector / block[k + 1, k]
        sums = basis.sum(axis=1)

        def law(count: int) -> Law:
            span, inner = np.linalg.eig(block[:count, :count])
            first = np.zeros(count)
            first[0] = length
            share = (sums[:count] @ inner) * np.linalg.solve(inner, first.astype(complex))
            slowest = np.real(inner[:, np.argmax(span.real)]) @ basis[:count]
            quasi = np.maximum(slowest / slowest.sum(), 0)
            return cls(longest * span.astype(complex), share, continuous, quasi / quasi.sum())

        return law(used), law(rough)

    @property
    def rate(self) -> float:
        """The probability of leaving in a step, or the rate per mean step, in the long run."""
        return float(1 / self.span.real.max())

    def stays(self, steps: float) -> float:
        """Compute the probability of being in the part after a number of steps."""
        with np.errstate(all="ignore"):
            per_step = -1 / self.span if self.continuous else np.log(1 - 1 / self.span)
            left = np.exp(steps * per_step)
        # Modes that would grow are not those of the chain.
        known = np.isfinite(left) & (np.abs(left) <= 1) & (self.span.real > 0)
        return float((self.share[known] * left[known]).sum().real)

    def quantile(self, share: float) -> float:
        """Compute the number of steps within which the chain leaves with a given probability."""
        low, high = 0.0, 1.0
        while self.stays(high) > 1 - share and high < 1e300:
            low, high = high, 2 * high
        if self.continuous:
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                low, high = (low, middle) if self.stays(middle) <= 1 - share else (middle, high)
            return high
        while high - low > max(1, 1e-12 * high):
            middle = (low + high) // 2
            low, high = (low, middle) if self.stays(middle) <= 1 - share else (middle, high)
        # Between two numbers of steps the law is interpolated.
        before, after = self.stays(low), self.stays(high)
        return low + (before - (1 - share)) / (before - after) if before > after else high


def visits_of(
    part: Transient, longest: float, continuous: bool, *, ahead: bool = False
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that computes expected visits from a start, which may be negative.

    With `ahead`, it is the adjoint: the function that sums a gain over the visits from each cell.
    """
    size = part.cells.size
    if size <= _DENSE:
        matrix = part.visited(np.eye(size))[0]
        return lambda start: np.asarray(start @ matrix if ahead else matrix @ start)
    if longest < _LONG and (continuous or size <= _FACTORED):
        solve = factored(part.step)
        return lambda start: solve(start[:, None], not ahead)[:, 0]
    if ahead:
        return lambda gain: solve_signed(lambda each: part.expect(each).value[:, :-1], gain)
    return lambda start: solve_signed(lambda columns: part.visited(columns)[0], start)
