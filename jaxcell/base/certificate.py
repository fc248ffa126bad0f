"""Certificates: checks of the answers of solvers."""

import dataclasses
import enum

from jaxtyping import Array, Float


class Outcome(enum.Enum):
    """The end of a solve; the value is a sentence about it."""

    CONVERGED = "the residual is within the tolerance"
    STALLED = "the residual stayed above the tolerance; the value is the best that was found"


@dataclasses.dataclass(frozen=True)
class Certificate:
    """A check of an answer that does not depend on the method of the solve."""

    iterations: int
    "Number of products with the matrix, or of changes of the active set."
    residual: float
    "Distance of the answer from a solution, in the measure that the function names."
    tolerance: float
    "The residual that counts as converged."

    @property
    def outcome(self) -> Outcome:
        """Converged if the residual is within the tolerance; a residual of NaN is not."""
        return Outcome.CONVERGED if self.residual <= self.tolerance else Outcome.STALLED

    def check(self, what: str, throw: bool) -> None:
        """Raise an error if `throw` is true and the answer did not converge."""
        if throw and self.outcome is not Outcome.CONVERGED:
            raise RuntimeError(
                f"{what}: {self.outcome.value} (residual {self.residual:.3g}, tolerance "
                f"{self.tolerance:.3g}, {self.iterations} iterations); throw=False returns it"
            )


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A number for every cell, or pair of cells, with a certificate."""

    value: Float[Array, "*cells"]
    certificate: Certificate
    moved: Float[Array, "*cells"] | None = None
    """The change of each value with half of the samples of the chain, `inf` if only one of both is
    infinite; `None` for a chain that is not made from samples."""
