"""Quantities beside an answer, whose failure does not end a run."""

from collections.abc import Callable
from typing import TypeVar


_Value = TypeVar("_Value")


class Secondary:
    """Computes secondary quantities, and keeps a sentence about each one that cannot be computed.

    A quantity that cannot be computed is left out:

        >>> from jaxcell.base.secondary import Secondary
        >>> beside = Secondary()
        >>> beside.compute("the ratio", lambda: 1 / 2), beside.compute("the other", lambda: 1 / 0)
        (0.5, None)
        >>> beside.left_out
        ('the other is left out: division by zero',)
    """

    def __init__(self) -> None:
        self.left_out: tuple[str, ...] = ()

    def compute(self, what: str, function: Callable[[], _Value]) -> _Value | None:
        """Return the result of `function`, or `None` if its computation fails."""
        # Imported here because pages of help do not need NumPy.
        from numpy.linalg import LinAlgError

        try:
            return function()
        # Failures of a computation; wrong input and errors of a program are not among them.
        except (RuntimeError, ArithmeticError, MemoryError, LinAlgError) as error:
            # Advice to a caller of the function does not help the reader of a result.
            reason = str(error).partition("; throw=False")[0] or type(error).__name__
            self.left_out += (f"{what} is left out: {reason}",)
            return None
