"""What a solve says of its own answer."""

import dataclasses
import enum

from jaxtyping import Array, Float


class Outcome(enum.Enum):
    """How a solve ended."""

    CONVERGED = "the residual is within the tolerance"
    STALLED = "the residual stayed above the tolerance; the value is the best that was found"


@dataclasses.dataclass(frozen=True)
class Certificate:
    """A check of an answer, made after it was found and without regard to how."""

    iterations: int
    "Products with the matrix, or changes of the active set, that were made."
    residual: float
    "How far the answer is from what was asked, in the measure that the function names."
    tolerance: float
    "The residual that counts as converged."

    @property
    def outcome(self) -> Outcome:
        """Whether the residual is within the tolerance; a residual that is not a number is not."""
        return Outcome.CONVERGED if self.residual <= self.tolerance else Outcome.STALLED

    def check(self, what: str, throw: bool) -> None:
        """Raise if asked to, and if the answer did not converge.

        **Raises:** `RuntimeError` with the sentence of the outcome and the residual.
        """
        if throw and self.outcome is not Outcome.CONVERGED:
            raise RuntimeError(
                f"{what}: {self.outcome.value} (residual {self.residual:.3g}, tolerance "
                f"{self.tolerance:.3g}, {self.iterations} iterations); throw=False gives it"
            )


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A number for every cell, and how good it is."""

    value: Float[Array, "cells"]
    certificate: Certificate
