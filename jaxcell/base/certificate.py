"""Certificates: the error of a solution, with what it may be at most."""

import dataclasses
import enum
from typing import TYPE_CHECKING, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .shown import Pictured, Shown
from .wide import traced


# Numbers in results. Under `jit`, `vmap` and `grad` they are arrays.
if TYPE_CHECKING:
    Real: TypeAlias = float
    Whole: TypeAlias = int
    Truth: TypeAlias = bool
    Numbers: TypeAlias = np.ndarray
else:
    Real = float | Float[Array, ""]
    Whole = int | Int[Array, ""]
    Truth = bool | Bool[Array, ""]
    Numbers = np.ndarray | Array


class Outcome(enum.Enum):
    """The outcome of a solver. The value of a member is its description in words."""

    CONVERGED = "the residual is within the tolerance"
    STALLED = "the residual stayed above the tolerance; the value is the best that was found"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Certificate(Shown):
    """The error of a solution: measured on the solution, or bounded for a direct method.

    Under `jit`, `vmap` and `grad` its fields are arrays, and no solver raises an error: see
    `converged`.
    """

    iterations: Whole
    "Number of iterations of the solver: matrix products, policies, or changes of the active set."
    residual: Real
    "Error of the solution, in a measure that the docstring of the solver defines."
    tolerance: Real
    "The largest residual that counts as converged."

    @property
    def converged(self) -> Truth:
        """`True` if the residual is at most the tolerance."""
        return self.residual <= self.tolerance

    @property
    def outcome(self) -> Outcome:
        """`STALLED` if the residual is NaN or above the tolerance; otherwise `CONVERGED`."""
        return Outcome.CONVERGED if self.converged else Outcome.STALLED

    def check(self, what: str, throw: bool) -> None:
        """Raise a `RuntimeError` about `what` if the solver stalled and `throw` is true."""
        if throw and not traced(self) and not self.converged:
            raise RuntimeError(
                f"{what}: {self.outcome.value} (residual {self.residual:.3g}, tolerance "
                f"{self.tolerance:.3g}, {self.iterations} iterations); throw=False returns it"
            )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Solution(Pictured):
    """The solution of a linear problem: a value per cell or pair of cells, with a certificate."""

    value: Float[Array, "*cells"]
    certificate: Certificate
    moved: Float[Array, "*cells"] | None = None
    """The change of each value if the coarser chain `Chain.half` is used, as an estimate of the
    error; `inf` if only one of the two values is infinite. Without such a chain it is `None`."""
