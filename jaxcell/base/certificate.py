"""Certificates: the error of a solution, computed from the solution itself."""

import dataclasses
import enum

from jaxtyping import Array, Float


class Outcome(enum.Enum):
    """The outcome of a solver. The value of a member is its description in words."""

    CONVERGED = "the residual is within the tolerance"
    STALLED = "the residual stayed above the tolerance; the value is the best that was found"


@dataclasses.dataclass(frozen=True)
class Certificate:
    """The error of a solution, computed from the solution itself and not by its solver."""

    iterations: int
    "Number of iterations of the solver: matrix products, or changes of the active set."
    residual: float
    "Error of the solution, in a measure that the docstring of the solver defines."
    tolerance: float
    "The largest residual that counts as converged."

    @property
    def outcome(self) -> Outcome:
        """`STALLED` if the residual is NaN or above the tolerance; otherwise `CONVERGED`."""
        return Outcome.CONVERGED if self.residual <= self.tolerance else Outcome.STALLED

    def check(self, what: str, throw: bool) -> None:
        """Raise a `RuntimeError` about `what` if the solver stalled and `throw` is true."""
        if throw and self.outcome is not Outcome.CONVERGED:
            raise RuntimeError(
                f"{what}: {self.outcome.value} (residual {self.residual:.3g}, tolerance "
                f"{self.tolerance:.3g}, {self.iterations} iterations); throw=False returns it"
            )


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a linear problem: a value per cell or pair of cells, with a certificate."""

    value: Float[Array, "*cells"]
    certificate: Certificate
    moved: Float[Array, "*cells"] | None = None
    """For a chain estimated from samples, the change of each value if only half of the samples are
    used; `inf` if only one of the two estimates is infinite. For other chains it is `None`."""
