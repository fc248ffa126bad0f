import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..base.shown import Shown
from ..base.wide import traced
from .advection import METHODS as INTEGRATORS
from .flow import Flow, crossing_time
from .water import Water


SPREADS = ("turned", "all", "sampled")
EDGES = ("uniform", "exit")
# The largest ratio of a duration to the crossing time, or of the crossing time to a duration.
_LONGEST = 1000


@dataclasses.dataclass(frozen=True)
class DriftStep(Shown):
    """A step of a drift map: its duration, and the rules for the images of each cell.

    The *image* of a cell is the cell to which the flow takes its centre; see
    [`jaxcell.drift.Water.landing`][]. Disturbances may bring the drifter to other cells; the image
    and these cells are the set `A(z)`. The image has probability `rho`, and each other cell of the
    set `(1 - rho) / (|A(z)| - 1)`. A cell that is reached in several ways counts once, and an image
    without other cells has probability 1.

    By default the rules are those of the dissertation. `METHODS` has rules that agree better with
    simulated drifters; its steps have no duration:

        >>> from jaxcell import drift
        >>> step = drift.METHODS["drifters"].lasting(3600.0)
        >>> step.duration, step.spread, step.edge
        (3600.0, 'sampled', 'exit')
    """

    duration: float | Any = None
    """The duration in seconds, negative for a step backward in time; by default the
    [`jaxcell.drift.crossing_time`][]. JAX may trace it for [`jaxcell.drift.flow_map`][]."""
    spread: str = "turned"
    """The rule for disturbances. With `"turned"`, they turn the displacement by 45 degrees to
    either side. With `"all"`, they lead to the eight neighbours of the image; then connected water
    tends to be one persistent group. With `"sampled"`, `samples` x `samples` points of the cell
    drift instead of the centre; the probability of a cell is the share of the points that end in it
    (Hsu 1987), and `rho` has no effect. A flow with a diffusivity requires `"sampled"`, and spreads
    the points at the end of the step."""
    rho: float | int = 0.8
    "The probability of the image, from 0 to 1."
    samples: int = 5
    """The number of points along each side of a cell, for the spread `"sampled"`."""
    edge: str = "uniform"
    """The rule at coasts and edges of the grid. With `"uniform"`, as in the dissertation, no
    drifter leaves, and a cell with fewer than eight neighbours is mapped to its neighbours and
    itself with equal probabilities. With `"exit"`, such a cell is mapped like other cells, and a
    drifter that ends off the grid, in sea without data, or stranded on land goes to the sink, which
    is one element of `A(z)`."""
    method: str = "euler"
    "The integration method, one of those of [`jaxcell.drift.advect`][]."
    substeps: int = 1
    "The number of steps of the integration method in each step of the map."

    def __post_init__(self) -> None:
        concrete = self.duration is not None and not traced(self.duration)
        if concrete and not (np.isfinite(self.duration) and self.duration != 0):
            raise ValueError(
                f"duration: expected a number of seconds other than 0, got {self.duration}"
            )
        if not 0 <= self.rho <= 1:
            raise ValueError(f"rho: expected a probability from 0 to 1, got {self.rho}")
        for name, known in (("spread", SPREADS), ("edge", EDGES), ("method", INTEGRATORS)):
            if (value := getattr(self, name)) not in known:
                *others, last = map(repr, known)
                raise ValueError(f"{name}: expected {', '.join(others)} or {last}, got {value!r}")
        for name in ("samples", "substeps"):
            if (value := getattr(self, name)) < 1:
                raise ValueError(f"{name}: expected 1 or more, got {value}")

    def lasting(self, duration: float | Any) -> "DriftStep":
        """Return this step with another duration, in seconds."""
        return dataclasses.replace(self, duration=duration)

    def seconds(self, water: Water, flow: Flow) -> Any:
        """Return the duration of the step in seconds, by default the crossing time of the flow."""
        if flow.rate.shape[2:] != water.number.shape:
            raise ValueError(
                f"flow: expected one over the {list(water.number.shape)} squares of this water, "
                f"got one over {list(flow.rate.shape[2:])}"
            )
        if flow.wraps != water.wraps:
            raise ValueError(
                f"flow: wraps: expected {water.wraps} as for this water, got {flow.wraps}; only "
                "one of them goes round the Earth"
            )
        if self.duration is None:
            return crossing_time(water, flow)
        given = self.duration
        return jnp.asarray(given, float) if traced(given) else float(given)

    def check_duration(self, crossing: float) -> None:
        """Raise `ValueError` unless the duration is 0.001 to 1000 times the crossing time."""
        least, most = crossing / _LONGEST, crossing * _LONGEST
        if self.duration is not None and not least <= self.duration <= most:
            raise ValueError(
                f"duration: expected {least:.3g} to {most:.3g} s, in which drifters go by "
                f"{1 / _LONGEST:g} to {_LONGEST:g} cells on average, got {self.duration:g}"
            )


METHODS: Mapping[str, DriftStep] = {
    "drifters": DriftStep(spread="sampled", edge="exit", method="rk4", substeps=4),
    "source": DriftStep(),
}
"""Steps by name, without a duration. The rules of `"drifters"` agree best with simulated drifters.
The rules of `"source"` are those of Alam 2018, section 5.4.3: the grid spreads drifters more than
the water does, and no drifter leaves the map."""
