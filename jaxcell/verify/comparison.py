import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse.linalg
from jaxtyping import Float, Int


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How a sample of a result compares with what another route gives."""

    what: str
    "What was compared, and what the other route is."
    count: int
    "How many numbers were compared; 0 where this could not be done."
    difference: float
    "The largest difference, or how many differ where they are to be the same."
    limit: float
    "How much of it rounding may explain."
    where: str = ""
    "Where the difference is largest, or why nothing was compared."

    @property
    def agrees(self) -> bool:
        """Whether rounding may explain the difference; one that is not a number is none such."""
        return self.difference <= self.limit

    def as_json(self) -> dict[str, Any]:
        """For a summary; numbers that JSON has not are `None`."""
        difference = self.difference if math.isfinite(self.difference) else None
        return {**dataclasses.asdict(self), "difference": difference, "agrees": self.agrees}

    @classmethod
    def exact(cls, what: str, wrong: list[str], count: int) -> "Comparison":
        """One of numbers that are to be the same.

        **Arguments:**

        - `what`: what was compared.
        - `wrong`: those that differ, in words.
        - `count`: how many there are.
        """
        return cls(what, count, float(len(wrong)), 0.0, wrong[0] if wrong else "")

    @classmethod
    def close(
        cls,
        what: str,
        found: npt.ArrayLike,
        again: npt.ArrayLike,
        limit: float,
        *,
        relative: bool = False,
    ) -> "Comparison":
        """One of numbers that rounding may change.

        **Arguments:**

        - `what`: what was compared.
        - `found`: the result.
        - `again`: the same by another route.
        - `limit`: the largest difference that is right.
        - `relative`: whether it is that of the numbers divided by those of `again`.
        """
        found, again = (np.asarray(values, float).ravel() for values in (found, again))
        scale = np.abs(again) if relative else 1
        with np.errstate(invalid="ignore", divide="ignore"):
            differ = np.where(found == again, 0.0, np.abs(found - again) / scale)
        differ = np.where(np.isnan(differ), np.inf, differ)
        worst = int(differ.argmax()) if differ.size else 0
        largest = float(differ[worst]) if differ.size else 0.0
        where = ""
        if not largest <= limit:
            where = f"entry {worst}: {found[worst]!r}, and {again[worst]!r} by the other route"
        return cls(what, differ.size, largest, limit, where)

    @classmethod
    def omitted(cls, what: str, why: str) -> "Comparison":
        """One that cannot be made of this result."""
        return cls(what, 0, 0.0, 0.0, why)


def sample(size: int, count: int, seed: int = 0) -> Int[np.ndarray, "sample"]:
    """Some of the numbers from 0 to `size - 1`: all, or as many as asked for, always the same."""
    if size <= count:
        return np.arange(size)
    return np.sort(np.random.default_rng(seed).choice(size, count, replace=False))


def solve_transient(
    P: scipy.sparse.csr_array, transient: Int[np.ndarray, "transient"], gained: np.ndarray
) -> Float[np.ndarray, "transient"]:
    """What is gained on the way from each transient cell, by a sparse direct solve."""
    system = scipy.sparse.eye_array(transient.size) - P[transient][:, transient]
    return np.atleast_1d(scipy.sparse.linalg.spsolve(system.tocsc(), gained))
