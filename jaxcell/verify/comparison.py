import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse.linalg
from jaxtyping import Float, Int

from ..base.shown import Shown


@dataclasses.dataclass(frozen=True)
class Comparison(Shown):
    """A comparison of a sample of a result with an independent computation."""

    what: str
    "The compared quantity, and the method of the independent computation."
    count: int
    "The number of compared values; 0 if a comparison was not possible."
    difference: float
    "The largest difference; for exact comparisons, the number of unequal values."
    limit: float
    "The largest difference that counts as rounding; 0 for exact comparisons."
    where: str = ""
    "The place of the largest difference, or the reason why nothing was compared."

    @property
    def agrees(self) -> bool:
        """True if the difference is at most the limit; false for NaN."""
        return self.difference <= self.limit

    def as_json(self) -> dict[str, Any]:
        """Convert the comparison to a JSON object, with `None` for infinity and NaN."""
        difference = self.difference if math.isfinite(self.difference) else None
        return {**dataclasses.asdict(self), "difference": difference, "agrees": self.agrees}

    @classmethod
    def exact(cls, what: str, wrong: list[str], count: int) -> "Comparison":
        """Create a comparison that requires equal values.

        `wrong` describes each value that differs, and `count` is the number of compared values.
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
        """Create a comparison within the tolerance `limit`.

        `reported` are the values of the result, and `again` those of the independent computation.
        If `relative` is true, the differences are divided by the absolute values of `again`.
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
        """Create the report that a quantity cannot be compared, with the reason `why`."""
        return cls(what, 0, 0.0, 0.0, why)


def sample(size: int, count: int, seed: int = 0) -> Int[np.ndarray, "sample"]:
    """Draw at most `count` sorted, different numbers below `size`, equal for equal arguments."""
    if size <= count:
        return np.arange(size)
    return np.sort(np.random.default_rng(seed).choice(size, count, replace=False))


def solve_transient(
    P: scipy.sparse.csr_array, transient: Int[np.ndarray, "transient"], gained: np.ndarray
) -> Float[np.ndarray, "transient"]:
    """Compute the expected total gain from each transient cell with a sparse direct solver.

    `P` is the transition matrix of all cells, `transient` are the transient cells, and `gained` is
    the gain at each visit of a transient cell.
    """
    system = scipy.sparse.eye_array(transient.size) - P[transient][:, transient]
    return np.atleast_1d(scipy.sparse.linalg.spsolve(system.tocsc(), gained))
