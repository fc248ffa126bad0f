"""Certificates: checks of solutions by solvers."""

import dataclasses
import enum

from jaxtyping import Array, Float


class Outcome(enum.Enum):
    """The outcome of a solve; the value describes the outcome in words."""

    CONVERGED = "the residual is within the tolerance"
    STALLED = "the residual stayed above the tolerance; the value is the best that was found"


@dataclasses.dataclass(frozen=True)
class Certificate:
    """A check of a solution, which does not depend on the method of the solver."""

    iterations: int
    "Number of matrix products, or of changes of the active set."
    residual: float
    "Error of the solution; the docstring of each solver defines this error."
    tolerance: float
    "The largest residual that counts as converged."

    @property
    def outcome(self) -> Outcome:
        """`CONVERGED` if the residual is at most the tolerance; `STALLED` otherwise, or for NaN."""
        return Outcome.CONVERGED if self.residual <= self.tolerance else Outcome.STALLED

    def check(self, what: str, throw: bool) -> None:
        """Raise `RuntimeError` if `throw` is true and the solver did not converge."""
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
    """The change of each value if the chain is made from half of its samples, `inf` if one of the
    two values is infinite; `None` for a chain that is not made from samples."""
