"""A study and its result as a user may write them: a stone that falls."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.study import AtLeastOne, Limit, Metres, Study, silent


@dataclasses.dataclass(frozen=True, eq=False)
class Fall(Result):
    title = "A stone that falls"
    tables = {"moment": "moments"}  # noqa: RUF012 - users do not annotate it

    height: Annotated[np.ndarray, quantity("step", "height of the stone", "m")]
    speed: Annotated[np.ndarray, quantity("moment", "speed of the stone", "m s-1")]
    lost: Annotated[float, quantity("", "energy that is lost", kind="share")]

    @derived("", "time of the fall", "s", kind="time")
    def seconds_down(self):
        return float(np.sqrt(2 * self.height[0] / 9.81))

    @property
    def answered(self):
        return self.lost < 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drop(Study):
    """Drop a stone."""

    name = "drop"

    height: Annotated[Metres, Limit(gt=0)]
    """Height of the start, in metres."""
    lost: float = 0.25
    """Energy that is lost."""
    winds: tuple[Annotated[float, Limit(le=9)], ...] = ()
    """Gusts on the way."""
    stones: AtLeastOne | Literal["all"] | None = None
    """Number of stones, or all."""
    kinds: tuple[str, ...] = ("stone",)
    """Kinds of the things that fall."""
    photographs: tuple[Path, ...] = ()
    """Pictures of the fall."""

    def run(self, say=silent):
        say("dropping")
        if self.height > 1000:
            raise RuntimeError("it burns up")
        t = np.linspace(0, 1, 5)
        return Fall(self.height * (1 - t**2), t[:2], self.lost)
