import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro

from .study import AtLeastOne, Limit, Say, Study, refuse


if TYPE_CHECKING:
    from ..optimize import Graph
    from ..patrol import GraphPatrol


_Positive: TypeAlias = Annotated[float, Limit("more than 0, and finite", lambda x: x > 0)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class GraphStudy(Study):
    """A question about robots on a graph, in steps or in seconds."""

    file: tyro.conf.Positional[Path]
    """Graph: a name such as @eight, or a file: node-link .json, .graphml, .gml, .adjlist, .graph of
    patrolling_sim, or a list of vertices and edges .edges or .txt. Vertices may have no positions;
    edges are then alike."""
    attack_time: int | None = None
    """Steps that an attack takes, or seconds with a speed, for "capture", which is by all."""
    robots: AtLeastOne = 1
    """How many patrollers walk, each by itself."""
    division: Literal["shared", "partition"] | None = None
    """Whether robots share the graph or have a part of it each; both are then compared. Without it
    they share it."""
    speed: _Positive | None = None
    """Metres a second, by which edges take as long as their lengths say; without it, a step."""
    time_unit: _Positive = 1.0
    """Seconds to which the times of edges are rounded."""
    base: str | None = None
    """A vertex where robots tell what they saw; how old news are there."""
    charger: str | None = None
    """A vertex where a robot must be every so many steps; what becomes of the walk, or for
    "capture" the best that is there in time."""
    every: int | None = None
    """The most steps between two times at the charger."""
    baselines: bool = False
    """Also simulate how long vertices wait for a visit, by this walk, by robots on a tour, by those
    that go anywhere and by those that go where nobody was for longest."""
    seed: int = 0
    """Seed of the walk that is recorded, and of simulations."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.charger is None) != (self.every is None):
            raise ValueError("every: expected with a charger, and only then")
        if self.speed is not None:
            refuse(self, "with a speed", "charger")
        if self.robots == 1:
            refuse(self, "for one robot", "division")

    def more(self, found: "GraphPatrol", say: Say) -> dict[str, Any]:
        """What else was asked of the walks."""
        from .. import patrol

        more: dict[str, Any] = {}
        times = self.times(found.graph)
        seconds = None if times is None else times * self.time_unit
        if seconds is not None:
            walks = found.matrices, found.shares
            more["timed"] = patrol.team.timed(found.graph, *walks, seconds, self.time_unit)
        if self.base is not None:
            say("following news")
            (base,) = self.vertices(found.names, "base", self.base)
            more["news"] = patrol.team.age_of_news(
                found.graph,
                found.matrices,
                base,
                times=times,
                unit=1.0 if times is None else self.time_unit,
                name=self.base,
            )
        if self.charger is not None and self.every is not None:
            (charger,) = self.vertices(found.names, "charger", self.charger)
            walk = found.graph, found.matrices, charger, self.every
            if self.attack_time is None:
                more["charged"] = patrol.team.charged(*walk, name=self.charger)
            else:
                say("seeking a walk that is back at the charger in time")
                options: Any = {"name": self.charger, "seed": self.seed}
                more["charged"] = patrol.walks.charged_capture(*walk, self.attack_time, **options)
        if self.baselines:
            say("simulating patrols")
            more["idleness"] = patrol.team.simulate_idleness(
                found.graph,
                found.matrices,
                times=seconds,
                attack_time=self.attack_time,
                seed=self.seed,
            )
        return more

    def times(self, graph: "Graph") -> Any:
        """How many units of time each edge takes, if that is asked for."""
        from ..patrol.team import whole_times

        return None if self.speed is None else whole_times(graph, self.speed, self.time_unit)

    def vertices(self, names: Sequence[str], parameter: str, *wanted: str) -> list[int]:
        """The numbers of vertices that a parameter names."""
        for name in wanted:
            if name not in names:
                listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                raise ValueError(f"{parameter}: there is no vertex {name!r}; there are {listed}")
        return [names.index(name) for name in wanted]
