import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse.linalg
from jaxtyping import Float, Int


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A comparison of a sample of a result with another computation."""

    what: str
    "The compared quantity and the other computation."
    count: int
    "Number of compared numbers; 0 if a comparison was not possible."
    difference: float
    "The largest difference, or the number of differences of exact numbers."
    limit: float
    "The difference that rounding may explain."
    where: str = ""
    "The place of the largest difference, or the reason why nothing was compared."

    @property
    def agrees(self) -> bool:
        """True if rounding may explain the difference; it never explains NaN."""
        return self.difference <= self.limit

    def as_json(self) -> dict[str, Any]:
        """Convert to JSON, with `None` for numbers that JSON does not have."""
        difference = self.difference if math.isfinite(self.difference) else None
        return {**dataclasses.asdict(self), "difference": difference, "agrees": self.agrees}

    @classmethod
    def exact(cls, what: str, wrong: list[str], count: int) -> "Comparison":
        """Make a comparison that requires equal numbers.

        **Arguments:**

        - `what`: the compared quantity.
        - `wrong`: a sentence for each difference.
        - `count`: number of compared numbers.
        """
        return cls(what, count, float(len(wrong)), 0.0, wrong[0] if wrong else "")

    @classmethod
    def close(
        cls,
        what: str,
        reported: npt.ArrayLike,
        again: npt.ArrayLike,
        limit: float,
        *,
        relative: bool = False,
    ) -> "Comparison":
        """Make a comparison within a tolerance.

        **Arguments:**

        - `what`: the compared quantity.
        - `reported`, `again`: the result, and the numbers of the other computation.
        - `limit`: the tolerance.
        - `relative`: whether differences are divided by the numbers of `again`.
        """
        reported, again = (np.asarray(values, float).ravel() for values in (reported, again))
        scale = np.abs(again) if relative else 1
        with np.errstate(invalid="ignore", divide="ignore"):
            differ = np.where(reported == again, 0.0, np.abs(reported - again) / scale)
        differ = np.where(np.isnan(differ), np.inf, differ)
        worst = int(differ.argmax()) if differ.size else 0
        largest = float(differ[worst]) if differ.size else 0.0
        where = ""
        if not largest <= limit:
            where = f"entry {worst}: {reported[worst]!r}, and {again[worst]!r} by the other route"
        return cls(what, differ.size, largest, limit, where)

    @classmethod
    def omitted(cls, what: str, why: str) -> "Comparison":
        """Report that a comparison of this result is not possible, and why."""
        return cls(what, 0, 0.0, 0.0, why)


def sample(size: int, count: int, seed: int = 0) -> Int[np.ndarray, "sample"]:
    """Draw a fixed sample of at most `count` numbers from 0 to `size - 1`."""
    if size <= count:
        return np.arange(size)
    return np.sort(np.random.default_rng(seed).choice(size, count, replace=False))


def solve_transient(
    P: scipy.sparse.csr_array, transient: Int[np.ndarray, "transient"], gained: np.ndarray
) -> Float[np.ndarray, "transient"]:
    """Sum the gains on the way from each transient cell, by a sparse direct solve."""
    system = scipy.sparse.eye_array(transient.size) - P[transient][:, transient]
    return np.atleast_1d(scipy.sparse.linalg.spsolve(system.tocsc(), gained))
