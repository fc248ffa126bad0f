import dataclasses
from collections.abc import Mapping

import numpy as np

from .advection import METHODS as INTEGRATORS
from .flow import Flow, crossing_time
from .water import Water


SPREADS = ("turned", "all", "sampled")
EDGES = ("uniform", "exit")
# The longest step, and one over the shortest, in times to cross a cell.
_LONGEST = 1000


@dataclasses.dataclass(frozen=True)
class DriftStep:
    """A step of a drift map: its duration, and the rules by which it maps each cell.

    The *image* of a cell is the cell to which the flow takes its centre,
    [`jaxcell.drift.Water.landing`][]. Disturbances may bring the drifter to other cells; with the
    image they are the set `A(z)`. The image has probability `rho`, and each other cell of the set
    `(1 - rho) / (|A(z)| - 1)`. Cells that are reached in several ways count once, and an image that
    is alone has probability 1.

    By default the rules are those of the dissertation. `METHODS` has others that agree with
    drifters, without a duration:

        >>> from jaxcell import drift
        >>> step = drift.METHODS["drifters"].lasting(3600.0)
        >>> step.duration, step.spread, step.edge
        (3600.0, 'sampled', 'exit')
    """

    duration: float | int | None = None
    """Seconds, negative for a step backward in time; by default
    [`jaxcell.drift.crossing_time`][]."""
    spread: str = "turned"
    """The disturbances. `"turned"`: the drift turned by 45 degrees to either side. `"all"`: the
    eight neighbours of the image; then connected water tends to be one persistent group.
    `"sampled"`: none, and `rho` has no effect. Instead of the centre, `samples` x `samples` points
    of the cell drift, and the probability of a cell is the share of the points that end there (Hsu
    1987). This choice is required if the flow has a diffusivity, which then spreads the points at
    the end of the step."""
    rho: float | int = 0.8
    "The probability of the image, from 0 to 1."
    samples: int = 5
    "The number of points along each side of a cell, for `spread`."
    edge: str = "uniform"
    """`"uniform"`, the rule of the source: a cell with fewer than eight neighbours is mapped to its
    neighbours and to itself, all with one probability, and nothing ever leaves the grid. `"exit"`:
    the cell is mapped like other cells, and a drifter that ends off the grid, in sea without data,
    or stranded on land goes to the sink (one element of `A(z)`)."""
    method: str = "euler"
    "The integration method, as for [`jaxcell.drift.advect`][]."
    substeps: int = 1
    "Number of steps of the integration method in each step of the map."

    def __post_init__(self) -> None:
        """**Raises:** `ValueError` for a number out of range, or an unknown choice."""
        if self.duration is not None and not (np.isfinite(self.duration) and self.duration != 0):
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

    def lasting(self, duration: float | int | None) -> "DriftStep":
        """Set the duration, in seconds."""
        return dataclasses.replace(self, duration=duration)

    def seconds(self, water: Water, flow: Flow) -> float:
        """Return the duration of the step in a flow, by default the time to cross a cell."""
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
        return crossing_time(water, flow) if self.duration is None else float(self.duration)

    def check_duration(self, crossing: float) -> None:
        """Raise `ValueError` unless the duration is 0.001 to 1000 times that of crossing a cell."""
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
"""Steps without a duration, by the rules that agree best with drifters in the current, and by those
of Alam 2018, section 5.4.3, where the grid spreads drifters more than the water does and no edge is
open."""
