import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from ..base.shown import Shown
from ..space.box import Box
from .maps import Map


@dataclasses.dataclass(frozen=True)
class System(Shown):
    """A map with its box, its parameters, and the names of its axes."""

    map: Map
    box: Box
    params: Mapping[str, float] = dataclasses.field(default_factory=lambda: MappingProxyType({}))
    labels: tuple[str, ...] = ()
    "The names of the axes, with units."
    about: str = ""
    "A one-line description of the system."

    def __post_init__(self) -> None:
        if self.labels and len(self.labels) != self.box.dimensions:
            raise ValueError(
                f"labels: expected a name for each of the {self.box.dimensions} axes, got "
                f"{len(self.labels)}"
            )
