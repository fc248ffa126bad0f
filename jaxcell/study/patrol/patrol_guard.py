import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import tyro

from ... import patrol, record, verify as verification
from ...base import memory
from ...base.doubts import Doubt, warn
from ...base.optional_modules import has_module
from ...base.secondary import Secondary
from ..parameters import AtLeastOne, Headings, Limit, Only
from ..study import Say, Study, silent
from .patrol_graph import GraphFile


_Positive: TypeAlias = Annotated[float, Limit(gt=0)]
# Largest number of vertices for which independent walks are searched for, and bytes per pair.
_WALKS, _BYTES = 40, 64
_Hours: TypeAlias = Annotated[float, Limit(gt=0, le=1000)]


def _walks(game: "patrol.rounds.Game") -> float | None:
    """Return the least capture by independent walks, or `None` where none are searched for.

    They are searched for on small undirected graphs whose vertices are all targets of equal value.
    """
    import numpy as np

    to, fro = np.sort(game.ends, axis=1), game.ends[:, 0] < game.ends[:, 1]
    whole = game.targets.size == len(game.names) <= _WALKS and not np.ptp(game.value)
    edges, times = to[fro], game.times[fro]
    back = dict(zip(map(tuple, to[~fro].tolist()), game.times[~fro].tolist(), strict=True))
    if not whole or back != dict(zip(map(tuple, edges.tolist()), times.tolist(), strict=True)):
        return None
    graph = patrol.Graph(edges, len(game.names), ways=times)
    attack = np.empty(game.targets.size)
    attack[game.targets] = game.attack
    unit = 1.0 if game.unit == "steps" else patrol.team.time_unit_of(graph, 1.0, attack)
    lasts = patrol.team.whole_times(graph, 1.0, unit)
    late = np.floor(attack / unit * (1 + 1e-9)).astype(np.int64)
    try:
        found = patrol.maximin_capture(
            graph, late, travel_times=lasts, robots=game.robots, throw=False
        )
    except ValueError:
        # No walk reaches each target in time.
        return 0.0
    if game.adversary == "watcher":
        return float(found.value)
    blind = patrol.walks.blind_capture(graph, found.matrices, late, lasts)
    return float(np.min(blind))


class _Rounds(Study):
    """Studies whose results are rounds of guards."""

    def write(self, result: Any, out: Path) -> None:
        rounds, game = patrol.rounds, result.game
        rounds.save_game(game, out / "game.json")
        rounds.save_routes(game, result.routes, out / "patrol.json")
        hour = 3600.0 if game.unit == "s" else 60.0
        night = getattr(self, "hours", 8.0) * hour
        rounds.save_timetable(game, result.routes, out / "schedule.csv", night)
        if has_module("matplotlib"):
            record.save_rounds(result, out / "rounds.png")

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_rounds(result)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolGuard(_Rounds):
    """Guard targets by rounds with a shared clock, so that the fewest attacks succeed."""

    name: ClassVar[str] = "guard"
    command: ClassVar[str] = "patrol guard"
    example: ClassVar[str] = "@eight --robots 2 --attack-time 6"
    headings: ClassVar[Headings] = {"How is the file read?": ("weight", "directed")}
    task: ClassVar[str] = "patrol_guard"

    file: tyro.conf.Positional[Annotated[GraphFile, tyro.conf.arg(constructor=Path)]] = (
        dataclasses.field(kw_only=False)
    )
    """Graph: a name such as @eight, or a file as for `jaxcell patrol graph`, also with directed and
    parallel edges; or a game, .json, as `jaxcell patrol guard --out` writes it."""
    robots: AtLeastOne | None = None
    """Number of guards; by default 1, or that of the game."""
    attack_time: _Positive | None = None
    """Duration of an attack in seconds or, without --speed, in steps. A graph needs it."""
    speed: _Positive | None = None
    """Speed in metres per second, which determines the time along each edge from its length. By
    default an edge takes one step."""
    targets: tuple[str, ...] = ()
    """Vertices that may be attacked; by default all."""
    attack_times: Annotated[Path | None, Only(attack_time=False)] = None
    """File with a line "vertex time" for each target, in place of --attack-time."""
    values: Path | None = None
    """File with a line "vertex value" for each target; by default all values are 1."""
    adversary: Literal["blind", "watcher"] | None = None
    """Knowledge of the adversary: he comes at a random time (blind, the default), or he sees the
    guards and chooses the moment (watcher)."""
    hours: _Hours = 8.0
    """Hours in schedule.csv, which --out writes; of 60 steps each, without --speed."""
    weight: str | None = None
    """Attribute of edges that is their length, such as weight; by default length. In a list of
    edges, the third word of an edge is its length then, whatever the name."""
    directed: bool = False
    """Take each edge of the file as one-way, from its first vertex to its second."""

    def run(self, say: Say = silent) -> "patrol.rounds.Guarded":
        game = self.game()
        targets, vertices = game.targets.size, len(game.names)
        doing = f"rounds through {targets:,} targets among {vertices:,} vertices"
        memory.check(_BYTES * targets * vertices, doing, "expected fewer targets")
        say(f"seeking {doing}")
        beside = Secondary()
        routes = patrol.rounds.best_routes(game)
        say("computing bounds")
        bound = beside.compute("the bound", lambda: patrol.rounds.bound(game))
        walks = None
        if patrol.rounds.evaluate(game, routes).exposure.any():
            say("seeking independent walks, to compare")
            walks = beside.compute("the comparison with walks", lambda: _walks(game))
        return patrol.rounds.Guarded.of(
            game, routes, bound=bound, walks_capture=walks, left_out=beside.left_out
        )

    def game(self) -> "patrol.rounds.Game":
        """Build the game of the parameters, or read it."""
        given = {"robots": self.robots, "adversary": self.adversary}
        known: Any = {name: value for name, value in given.items() if value is not None}
        if isinstance(self.file, Path) and patrol.rounds.is_game(self.file):
            for name in (
                "attack_time",
                "speed",
                "targets",
                "attack_times",
                "values",
                "weight",
                "directed",
            ):
                if getattr(self, name):
                    raise ValueError(f"{name}: {self.file} is a game, which has its own")
            return dataclasses.replace(patrol.rounds.load_game(self.file), **known)
        if self.attack_time is None and self.attack_times is None:
            raise ValueError("expected one of `attack_time` or `attack_times`")
        ways = patrol.files.load_ways(self.file, self.weight, self.directed)
        names = self.targets or ways.names
        attack: Any = self.attack_time
        if self.attack_times is not None:
            attack = patrol.files.load_values(self.attack_times, names)
        value = 1.0 if self.values is None else patrol.files.load_values(self.values, names)
        game = patrol.rounds.Game.of(
            ways, attack, targets=self.targets, value=value, speed=self.speed, **known
        )
        for omitted in game.omitted:
            warn(f"{self.file}: {omitted}", Doubt)
        return game

    def headline(self, spec: dict[str, Any]) -> str:
        return f"{spec['file']}: guards with a shared clock"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatrolEvaluate(_Rounds):
    """Evaluate the routes of guards in a game: times between visits, and attacks that succeed."""

    name: ClassVar[str] = "evaluated"
    command: ClassVar[str] = "patrol evaluate"
    example: ClassVar[str] = "game.json patrol.json"
    task: ClassVar[str] = "patrol_evaluate"

    file: tyro.conf.Positional[Path] = dataclasses.field(kw_only=False)
    """Game: a .json file with vertices, ways, targets, and the number of guards."""
    strategy: tyro.conf.Positional[Path] = dataclasses.field(kw_only=False)
    """Routes of the guards: a .json file with the visits of each and their times."""

    def run(self, say: Say = silent) -> "patrol.rounds.Guarded":
        game = patrol.rounds.load_game(self.file)
        routes = patrol.rounds.load_routes(self.strategy, game)
        beside = Secondary()
        bound = beside.compute("the bound", lambda: patrol.rounds.bound(game))
        return patrol.rounds.Guarded.of(game, routes, bound=bound, left_out=beside.left_out)

    def headline(self, spec: dict[str, Any]) -> str:
        return f"{spec['strategy']} in {spec['file']}"
