import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Float

from ...base.doubts import warn
from ...base.shown import Shown
from ..system import System
from .ends import Region
from .escape import escape
from .family import Family


_NUMBERS = "mean_time", "mean_time_error", "derivative", "derivative_error", "residual"


@dataclasses.dataclass(frozen=True, eq=False)
class ExitTimes(Shown):
    """Mean times that a noisy system stays, along values of a parameter."""

    mean_time: Float[np.ndarray, "members"]
    mean_time_error: Float[np.ndarray, "members"]
    derivative: Float[np.ndarray, "members"]
    "The derivative of the mean time by the parameter."
    derivative_error: Float[np.ndarray, "members"]
    residual: Float[np.ndarray, "members"]
    """A bound on the relative error of the mean times of the chains, for given probabilities: the
    product of the relative residuals of times and of visits."""
    alone: Bool[np.ndarray, "members"]
    "The members that [`escape`][] computed, because their residual was above 4e-10."
    solved: int
    "The number of chains between which solutions were interpolated."
    share: Float[np.ndarray, "members regions"] | None = None
    """The share of time in each region in the long run, with `shares`; NaN if it cannot be solved.
    It is that of the chain of the box: in the middle of each interval between solved chains, it
    differs from it by less than 2e-7."""


def exit_times(
    system: System,
    name: str,
    values: npt.ArrayLike,
    *,
    noise: float | tuple[float, ...],
    start: Sequence[float | int] | np.ndarray,
    into: Mapping[str, Region] | Region | None = None,
    out_of: Region | None = None,
    shares: bool = False,
) -> ExitTimes:
    """Compute the mean time that a noisy system stays, for many values of a parameter.

    The times, derivatives and errors are those of [`escape`][] for a map with noise once per
    mapping, extrapolated to cells without width. Only the rate in the error of the times is
    approximate. Chains are solved only at values on a lattice. In between, the logarithms of times
    and of visits to cells are interpolated. Every member has chains of its own, with which
    residuals are computed: if `r` is what is missing in the equation of the interpolated times, the
    visits times `r` correct the mean time to second order. The derivative is that of the corrected
    time (Schweitzer 1968). The lattice depends on the speed of the images in the parameter,
    relative to the noise, and is refined where residuals are large. So a member does not depend on
    the others.

    **Arguments:**

    - `system`: a map that is not a flow, with a box and parameters.
    - `name`, `values`: a parameter of the system, and its values.
    - `noise`, `start`, `into`, `out_of`: as in [`escape`][]; the noise is not 0 along any axis.
    - `shares`: whether to add the share of time in each region in the long run, if the system goes
        on there. They follow from the visits to all cells between two visits to a cell at the
        start, which are interpolated, too.

    **Returns:** an [`ExitTimes`][]. It warns if derivatives are not finite.

    **Raises:** `ValueError` if the map has values that are not finite in a cell outside of regions.

    A particle that jumps between two wells:

        >>> import numpy as np
        >>> from jaxcell import dynamics, space
        >>> box = space.Box([-2], [2], cells=[60], axes="clamp")
        >>> well = dynamics.System(lambda x, p: x + 0.3 * (p["a"] * x - x**3), box, {"a": 1.0})
        >>> found = dynamics.exit_times(
        ...     well, "a", np.linspace(1, 1.2, 30),
        ...     noise=0.2, start=[-1], into=lambda x: x[:, 0] > 0,
        ... )
        >>> found.mean_time[[0, -1]].round(1).tolist(), int(found.alone.sum())
        ([380.7, 1429.6], 0)
        >>> found.mean_time_error[[0, -1]].round(1).tolist()
        [38.4, 224.4]
    """
    values = np.asarray(values, float)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError("values: expected finite numbers, one for each member")
    about: dict[str, Any] = {"noise": noise, "start": start, "into": into, "out_of": out_of}
    family = Family.of(system, name, **about)
    found: list[Any] = [family.at(value) for value in values.tolist()]
    alone = np.array([one is None for one in found], bool)
    for k in np.flatnonzero(alone):
        own = {**system.params, name: float(values[k])}
        one = escape(system, params=own, gradient=True, **about)
        cause = (one.cause or ()).index(name)
        every = {key: np.asarray(getattr(one, key)) for key in _NUMBERS}
        found[k] = {key: value[cause] if value.ndim else value for key, value in every.items()}
    numbers = {key: np.array([one[key] for one in found], float) for key in _NUMBERS}
    warn_of_slopes(numbers["derivative"], "derivative")
    share = None
    if shares:
        whole = Family.of(system, name, **about, back=True)
        share = np.array([whole.shares(value) for value in values.tolist()])
    solved = sum(len(one.nodes) for one in (family, *family.coarser))
    return ExitTimes(**numbers, alone=alone, solved=solved, share=share)


def warn_of_slopes(slopes: Float[np.ndarray, "members"], name: str) -> None:
    """Warn of derivatives that are not finite."""
    if lost := np.count_nonzero(~np.isfinite(slopes)):
        warn(f"{name}: not finite for {lost:,} of {slopes.size:,} values of the parameter")
