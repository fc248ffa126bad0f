import dataclasses
from typing import Any, ClassVar, Literal

from .. import dynamics
from .dynamics import SystemStudy, read_params
from .parameters import AtLeastOne, WholeNumber
from .study import Say, silent


@dataclasses.dataclass(frozen=True, kw_only=True)
class Morse(SystemStudy):
    """Find recurrent sets of a dynamical system, and prove in which order orbits can visit them."""

    name: ClassVar[str] = "morse"
    command: ClassVar[str] = "morse"
    example: ClassVar[str] = "henon --cells 4 --depth 16 --check 4"
    task: ClassVar[str] = "morse"

    cells: tuple[AtLeastOne, ...] = ()
    """Number of cells along each axis at the start, or one number for all axes; by default the
    numbers of the system."""
    depth: WholeNumber = 0
    """Number of bisections of boxes, along each axis in turn; after each bisection, boxes that are
    not recurrent are removed."""
    check: WholeNumber = 0
    """Number of further bisections that test the found sets. Sets that prove not to be recurrent
    are removed."""
    images: Literal["intervals", "mean-value", "corners"] = "mean-value"
    """Method for images of boxes: interval arithmetic (intervals), interval arithmetic and the mean
    value theorem (mean-value), or images of corners (corners), which prove nothing."""

    def run(self, say: Say = silent) -> "dynamics.MorseSets":
        system = self.chosen
        params = read_params(self.params, dict(system.params))
        for name, value in params.items():
            if isinstance(value, list):
                raise ValueError(f"params: {name}: expected one value, got {len(value)}")
        map = system.map
        kinds: dict[str, dynamics.OuterMap] = {
            "intervals": dynamics.Intervals(map, mean_value=False),
            "mean-value": dynamics.Intervals(map),
            "corners": dynamics.Corners(map),
        }
        options: dict[str, Any] = {
            "depth": self.depth,
            "check": self.check,
            "labels": system.labels,
            "say": say,
        }
        return dynamics.morse_sets(kinds[self.images], system.box, params, **options)
