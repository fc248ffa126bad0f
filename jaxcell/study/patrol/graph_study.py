import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro

from ... import optimize, patrol
from ...base.secondary import Secondary
from ..parameters import AtLeastOne, Limit, Needed, Only
from ..study import Say, Study


_Positive: TypeAlias = Annotated[float, Limit(gt=0)]


# A walk on a part of a graph cannot have parameters that name vertices outside this part.
_OF_ALL = Only(
    robots=True, vertex=False, emphasis=False, visits=False, attack_times=False, constraints=False
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class GraphStudy(Study):
    """Base class of studies of robots that patrol a graph, with time in steps or in seconds."""

    file: tyro.conf.Positional[Annotated[Path | Any, tyro.conf.arg(constructor=Path)]]
    """Graph: a name such as @eight, or a file: node-link .json, .graphml, .gml, .adjlist, .graph of
    patrolling_sim, or a list of vertices and edges in .edges or .txt. If vertices have no
    positions, all edges have the same length."""
    attack_time: Annotated[int | None, Needed(strategy="capture", attack_times=False)] = None
    """Duration of an attack in steps, or in seconds with --speed."""
    robots: AtLeastOne = 1
    """Number of patrollers, which walk independently."""
    division: Annotated[Literal["shared", "partition"] | None, _OF_ALL] = None
    """Division of the graph among several robots: all patrol the whole graph (shared), or each
    patrols a part of it (partition). The result compares both. By default all patrol the whole
    graph, and nothing is compared."""
    speed: _Positive | None = None
    """Speed in metres per second, which determines the travel time of each edge. By default an edge
    takes one step."""
    time_unit: Annotated[_Positive | None, Only(speed=True)] = None
    """Unit of time in seconds. Travel times of edges are rounded up to multiples of this unit, and
    durations of attacks down, so that the walk captures at least what is computed. A smaller unit
    takes longer. By default it is 1 s or, with attacks, a fraction of the longest attack down to
    1/24, for which times are rounded least."""
    base: str | None = None
    """Base station: a vertex where robots report news. The result contains the age of the news at
    the base."""
    charger: Annotated[str | None, Only(speed=False)] = None
    """Vertex to which each robot must return within --every steps. The walk is changed to meet this
    condition; with --attack-time, a new walk is optimized under this condition instead."""
    every: Annotated[int | None, Needed(charger=True)] = None
    """Largest number of steps between two visits to the charger."""
    baselines: bool = False
    """Simulate the times between visits to a vertex: for this walk, for robots on a tour, for
    robots that choose a neighbour uniformly, and for robots that choose the neighbour whose last
    visit is longest ago."""
    seed: int = 0
    """Seed of the recorded walk, and of simulations."""

    def more(self, patrolled: "patrol.GraphPatrol", say: Say) -> dict[str, Any]:
        """Compute the additional results that options such as `base` and `baselines` request."""
        more: dict[str, Any] = {}
        beside = Secondary()
        times = self.times(patrolled.graph)
        seconds = None if times is None else times * self.unit
        if seconds is not None:
            walks = patrolled.matrices, patrolled.shares
            more["timed"] = beside.compute(
                "the table of times in seconds",
                lambda: patrol.team.timed(patrolled.graph, *walks, seconds, self.unit),
            )
        if self.base is not None:
            say("following news")
            (base,) = self.vertices(patrolled.names, "base", self.base)
            more["news"] = beside.compute(
                "the age of news",
                lambda: patrol.team.age_of_news(
                    patrolled.graph,
                    patrolled.matrices,
                    base,
                    times=times,
                    unit=self.unit,
                    names=patrolled.names,
                ),
            )
        if self.charger is not None and self.every is not None:
            (charger,) = self.vertices(patrolled.names, "charger", self.charger)
            walk = patrolled.graph, patrolled.matrices, charger, self.every
            if self.attack_time is None:
                charge = functools.partial(patrol.team.charged, *walk, names=patrolled.names)
            else:
                say("seeking a walk that is back at the charger in time")
                options: Any = {"names": patrolled.names, "seed": self.seed}
                options["attack_time"] = self.attack_time
                charge = functools.partial(patrol.walks.charged_capture, *walk, **options)
            more["charged"] = beside.compute("the walk that returns to the charger", charge)
        if self.baselines:
            say("simulating patrols")
            more["idleness"] = beside.compute(
                "the simulation of patrols",
                lambda: patrol.team.simulate_idleness(
                    patrolled.graph,
                    patrolled.walks,
                    times=seconds,
                    attack_time=self.attack_time,
                    seed=self.seed,
                ),
            )
        if beside.left_out:
            more["left_out"] = patrolled.left_out + beside.left_out
        return more

    def times(self, graph: "optimize.Graph") -> Any:
        """Return the travel time of each edge in units of `time_unit`; `None` without a speed."""
        if self.speed is None:
            return None
        return patrol.team.whole_times(graph, self.speed, self.unit)

    @property
    def unit(self) -> float:
        """The unit of time: a step, or with a speed, the unit in seconds."""
        return 1.0 if self.time_unit is None else self.time_unit

    def spec(self, result: "patrol.GraphPatrol") -> dict[str, Any]:  # type: ignore[override]
        spec = super().spec(result)
        return spec if self.speed is None else spec | {"time_unit": result.time_unit}

    def vertices(self, names: Sequence[str], parameter: str, *wanted: str) -> list[int]:
        """Return the index in `names` of each vertex in `wanted`. Errors name `parameter`."""
        for name in wanted:
            if name not in names:
                listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
                raise ValueError(f"{parameter}: there is no vertex {name!r}; there are {listed}")
        return [names.index(name) for name in wanted]
