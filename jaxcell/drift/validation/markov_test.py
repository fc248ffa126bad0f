"""The Chapman-Kolmogorov test of a drift map on sets of cells, against simulated drifters."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Int

from ...base.quantities import Result, derived, quantity
from ...mapping import Chain, ChainSequence
from ...markov.estimation import chapman_kolmogorov


@dataclasses.dataclass(frozen=True, eq=False)
class MarkovTest(Result):
    """The share of each set's drifters that are in it later, as a map predicts and as simulated.

    If the drifters are a Markov chain, the `n`-th power of the map predicts the shares after `n`
    steps (Prinz et al. 2011). A *case* is a set and a time. By the map, half of the drifters of
    set 0 are still in it after a step; of four simulated drifters only one is, which is 0.25 apart:

        >>> import numpy as np
        >>> from jaxcell import drift, mapping
        >>> chain = mapping.Chain.from_scipy(np.array([[0.5, 0.5], [0.0, 1.0]]))
        >>> origin, end = np.array([0, 0, 0, 0, 1]), np.array([0, 1, 1, 1, 1])
        >>> cases = drift.MarkovTest.of(chain, np.array([0, 1]), 3600.0, [(1, origin, end)])
        >>> cases.by_map.tolist(), cases.by_drifters.tolist(), cases.apart
        ([0.5, 1.0], [0.25, 1.0], 0.25)
    """

    tables: ClassVar[dict[str, str]] = {"case": "cases"}

    number: Annotated[Int[np.ndarray, "cases"], quantity("case", "set", kind="index")]
    depth: Annotated[Float[np.ndarray, "cases"], quantity("case", "depth", "m")]
    hours: Annotated[Float[np.ndarray, "cases"], quantity("case", "time", "h", kind="time")]
    by_map: Annotated[
        Float[np.ndarray, "cases"],
        quantity("case", "drifters of the set that are in it then, by the map", kind="share"),
    ]
    by_drifters: Annotated[
        Float[np.ndarray, "cases"], quantity("case", "the same, by drifters", kind="share")
    ]
    error: Annotated[
        Float[np.ndarray, "cases"],
        quantity("case", "standard error, because drifters are finite", kind="share"),
    ]

    @classmethod
    def of(
        cls,
        chain: Chain | ChainSequence,
        sets: Int[np.ndarray, "cells"],
        seconds: float | int,
        seen: Sequence[tuple[int, npt.ArrayLike, npt.ArrayLike]],
        depth: float | int = 0.0,
        first: int = 0,
    ) -> "MarkovTest":
        """Test a map on sets of cells.

        **Arguments:**

        - `chain`: the drift map, or the sequence of maps of a periodic current.
        - `sets`: the number of the set that contains each cell, or -1.
        - `seconds`: the duration of a step.
        - `seen`: for each time, three items: the number of steps, the cells in which simulated
            drifters began at phase 0, and the cells in which they ended (-1 off the map).
        - `depth`: depth of the cells, in metres.
        - `first`: the number that the result gives to set 0; sets 1, 2, ... get the next numbers.
        """
        test = chapman_kolmogorov(chain, sets, seen)
        time, number = np.nonzero(test.walkers)
        hours = np.array([count for count, *_ in seen], float)[time] * seconds / 3600
        shares = (x[time, number] for x in (test.by_chain, test.seen, test.error))
        depths = np.full(time.size, float(depth))
        return cls((first + number).astype(np.int32), depths, hours, *shares)

    @classmethod
    def joined(cls, tests: Sequence["MarkovTest"]) -> "MarkovTest":
        """Join the cases of several tests, such as those of all layers."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(*(np.concatenate([getattr(test, name) for test in tests]) for name in names))

    @derived("", "largest difference of the shares by the map and by drifters", kind="share")
    def apart(self) -> float:
        return float(np.abs(self.by_map - self.by_drifters).max(initial=0.0))
