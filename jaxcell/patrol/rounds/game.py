import dataclasses
import functools
import json
import os
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...base.documents import Fields, about, check_file, decode_json, read_text, refused
from ...base.paths import replacing
from ...base.shown import Pictured
from ...optimize.validation import check_count, one_each
from ..files.graph_files import Ways, about_omitted, load_ways


Adversary: TypeAlias = Literal["blind", "watcher"]
# Largest number of vertices that a sentence lists.
_NAMED = 6
_NO_TARGETS = "vertices are no targets, because no way"
_CHOICES = {"unit": ("s", "steps"), "adversary": ("blind", "watcher")}
# The fields of a game, and of its parts.
_KNOWN = {
    "": ("version", "unit", "robots", "adversary", "vertices", "ways", "targets"),
    "vertices": ("name", "x", "y"),
    "ways": ("from", "to", "time"),
    "targets": ("vertex", "attack_time", "value"),
}
# Parts of the names of fields that other games have, and what is possible here.
_ELSEWHERE = {
    "detect prob sight": "a visit always stops an attack, and guards see one vertex at a time",
    "share stationary": "routes have no prescribed shares of time; random walks that have them are "
    "found by `patrol.maximin_capture` with `stationary`",
    "start speed": "guards begin anywhere, and all need the `time` of a way",
    "last memory seen sees": "`adversary` is blind or watcher, who remembers all that he sees",
    "cost damage grow loss": "`value` is lost if an attack succeeds, whenever it began",
}
# The least time of a way between two vertices in one place; sparse matrices leave out 0.
_BRIEFEST = 1e-9


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Game(Pictured):
    """Robots that guard targets on ways with travel times.

    Two robots at 1 m/s on a line of three vertices, whose ends are attacked for 10 s:

        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [3, 4], [3, 5]])
        >>> game = patrol.rounds.Game.of(line, 10.0, robots=2, targets=["0", "2"], speed=1.0)
        >>> game.between.tolist()
        [[0.0, 6.0], [6.0, 0.0]]
    """

    names: tuple[str, ...]
    "The name of each vertex."
    ends: Int[np.ndarray, "ways 2"]
    "The vertices where each way begins and ends."
    times: Float[np.ndarray, "ways"]
    "The travel time of each way."
    targets: Int[np.ndarray, "targets"]
    "The vertices that may be attacked."
    attack: Float[np.ndarray, "targets"]
    "The duration of an attack on each target."
    value: Float[np.ndarray, "targets"]
    "The value of each target."
    robots: int = 1
    unit: Literal["s", "steps"] = "s"
    adversary: Adversary = "blind"
    xy: Float[np.ndarray, "vertices 2"] | None = None
    "The position of each vertex, in metres, or `None`."
    omitted: tuple[str, ...] = ()
    "Sentences about edges of a file that are left out."

    @classmethod
    def of(
        cls,
        graph: Any,
        attack_time: Any,
        *,
        robots: int = 1,
        targets: Sequence[str] = (),
        value: Any = 1.0,
        speed: float | None = None,
        adversary: Adversary = "blind",
    ) -> "Game":
        """Create a game on a graph.

        **Arguments:**

        - `graph`: a graph, a graph of networkx, or a file, as for [`load_ways`][], or its result.
        - `attack_time`: the duration of an attack in seconds, or in steps without a speed; or an
            array `[targets]` of them.
        - `robots`: number of robots.
        - `targets`: names of the vertices that may be attacked; by default all or, if there are
            fewer robots than parts with ways there and back, those in the largest part.
        - `value`: the value of a target, or an array `[targets]`.
        - `speed`: metres per second; by default each way takes one step.
        - `adversary`: `blind` or `watcher`.
        """
        ways = graph if isinstance(graph, Ways) else load_ways(graph)
        unit: Literal["s", "steps"] = "steps" if speed is None else "s"
        times = np.ones(len(ways.ends))
        if speed is not None:
            if ways.lengths is None:
                raise ValueError("speed: edges have no lengths, and vertices no positions")
            if not 0 < speed < np.inf:
                raise ValueError(f"speed: expected a positive finite number, got {speed}")
            times = np.maximum(ways.lengths / speed, _BRIEFEST)
        vertices, omitted = len(ways.names), ways.omitted
        chosen = np.array(_numbers(ways.names, targets) if len(targets) else range(vertices))
        attack = _each("attack_time", attack_time, chosen.size)
        worth = _each("value", value, chosen.size)
        if not len(targets):
            kept = _joined(ways, robots)
            chosen, attack, worth = chosen[kept], attack[kept], worth[kept]
            omitted += about_unguarded(ways, robots)
        return cls(
            names=ways.names,
            ends=ways.ends,
            times=times,
            targets=chosen,
            attack=attack,
            value=worth,
            robots=robots,
            unit=unit,
            adversary=adversary,
            xy=ways.xy,
            omitted=omitted,
        )

    @property
    def unguarded(self) -> bool:
        """`True` if vertices are no targets because no way leads there and back."""
        return any(_NO_TARGETS in each for each in self.omitted)

    def __post_init__(self) -> None:
        check_count("robots", self.robots)
        for field, choices in _CHOICES.items():
            if (given := getattr(self, field)) not in choices:
                raise refused(field, " or ".join(choices), given)
        parts, part = self.components
        if self.robots < parts:
            apart = self.names_of_targets[int(np.argmax(part != part[0]))]
            raise ValueError(
                f"robots: expected at least {parts}, one for each connected part of the targets, "
                f"got {self.robots}; no way leads from {self.names_of_targets[0]!r} to {apart!r} "
                "and back"
            )

    @property
    def names_of_targets(self) -> list[str]:
        return [self.names[target] for target in self.targets.tolist()]

    @property
    def whole(self) -> bool:
        """`True` if robots move in steps, all at the same moments."""
        return self.unit == "steps" and bool((self.times == np.rint(self.times)).all())

    @functools.cached_property
    def _paths(self) -> tuple[Any, Any]:
        shape = (len(self.names),) * 2
        matrix = scipy.sparse.csr_array((self.times, tuple(self.ends.T)), shape=shape)
        return scipy.sparse.csgraph.dijkstra(matrix, indices=self.targets, return_predecessors=True)

    @functools.cached_property
    def between(self) -> Float[np.ndarray, "targets targets"]:
        """The shortest time from each target to each; infinite if there is no way."""
        return self._paths[0][:, self.targets]

    @functools.cached_property
    def components(self) -> tuple[int, Int[np.ndarray, "targets"]]:
        """The number of parts of the targets with ways there and back, and the part of each."""
        joined = scipy.sparse.csr_array(np.isfinite(self.between))
        return scipy.sparse.csgraph.connected_components(joined, connection="strong")

    def walk(
        self, order: Int[np.ndarray, "stops"]
    ) -> tuple[Int[np.ndarray, "steps"], Float[np.ndarray, "steps"], float]:
        """Follow the shortest ways through targets in an order, and back to the first.

        **Returns:** the vertices on the way, the times when they are visited, and the duration."""
        reached, before = self._paths
        vertices, begins, now = [], [], 0.0
        for here, there in zip(order.tolist(), np.roll(order, -1).tolist(), strict=True):
            leg = [int(self.targets[there])]
            while leg[-1] != self.targets[here]:
                leg.append(int(before[here, leg[-1]]))
            leg = leg[:0:-1]
            vertices += leg
            begins += (now + reached[here, leg]).tolist()
            now += float(reached[here, self.targets[there]])
        if not vertices:
            return self.targets[order], np.zeros(1), 0.0
        return np.array(vertices), np.array(begins), now


def _joined(ways: Ways, robots: int) -> Bool[np.ndarray, "vertices"]:
    """Return the vertices of the largest part with ways there and back; all if robots suffice."""
    shape = (len(ways.names),) * 2
    matrix = scipy.sparse.csr_array((np.ones(len(ways.ends)), tuple(ways.ends.T)), shape=shape)
    count, part = scipy.sparse.csgraph.connected_components(matrix, connection="strong")
    return part == np.bincount(part).argmax() if count > robots else np.full(part.size, True)


def about_unguarded(ways: Ways, robots: int) -> tuple[str, ...]:
    """Say which vertices are no targets by default, if any."""
    left = np.flatnonzero(~_joined(ways, robots))
    listed = ", ".join(ways.names[v] for v in left[:_NAMED].tolist())
    what = f"{left.size:,} of {len(ways.names):,} {_NO_TARGETS} leads there and back: {listed}"
    more = ", ..." * (left.size > _NAMED)
    return (f"{what}{more}; to choose, set `targets`",) * bool(left.size)


def _each(name: str, given: Any, count: int) -> Float[np.ndarray, "targets"]:
    given = np.full(count, given) if np.ndim(given) == 0 else given
    return one_each(name, given, count, "per target")


def _numbers(names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    number = {name: vertex for vertex, name in enumerate(names)}
    for i, name in enumerate(wanted):
        if name not in number:
            listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            raise ValueError(f"targets: there is no vertex {name!r}; there are {listed}")
        if name in wanted[:i]:
            raise ValueError(f"targets: vertex {name!r} comes twice")
    return [number[name] for name in wanted]


def save_game(game: Game, path: str | os.PathLike[str]) -> None:
    """Write a game as JSON, whose fields are those that [`load_game`][] reads."""
    places: list[dict[str, float]] = [{}] * len(game.names)
    if game.xy is not None:
        places = [{"x": x, "y": y} for x, y in game.xy.tolist()]
    named = [(game.names[a], game.names[b]) for a, b in game.ends.tolist()]
    document = {
        "version": 1,
        "unit": game.unit,
        "robots": game.robots,
        "adversary": game.adversary,
        "vertices": [{"name": n} | at for n, at in zip(game.names, places, strict=True)],
        "ways": [
            {"from": a, "to": b, "time": time}
            for (a, b), time in zip(named, game.times.tolist(), strict=True)
        ],
        "targets": [
            {"vertex": name, "attack_time": attack, "value": value}
            for name, attack, value in zip(
                game.names_of_targets, game.attack.tolist(), game.value.tolist(), strict=True
            )
        ],
    }
    with replacing(Path(path)) as temporary:
        temporary.write_text(_lines(document), encoding="utf-8")


def _lines(document: dict[str, Any]) -> str:
    """Format a JSON object of lists with one line for each member of a list."""
    parts = []
    for key, value in document.items():
        text = json.dumps(value)
        if isinstance(value, list):
            text = "[\n    " + ",\n    ".join(map(json.dumps, value)) + "\n  ]"
        parts.append(f'"{key}": {text}')
    return "{\n  " + ",\n  ".join(parts) + "\n}\n"


def is_game(path: str | os.PathLike[str]) -> bool:
    """Check whether a file is a game, by its suffix and the key of its targets.

    **Raises:** `ValueError` if a `.json` file has no JSON."""
    path = Path(path)
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    with about(path):
        document = decode_json(read_text(path), "a game or a graph")
    return isinstance(document, dict) and "targets" in document


def load_game(path: str | os.PathLike[str]) -> Game:
    """Read a game from JSON.

    The file is an object with `vertices`, a list of objects with a `name` and perhaps `x` and `y`
    in metres; `ways`, with `from`, `to` and a `time`, in this direction; and `targets`, with a
    `vertex`, an `attack_time`, and a `value`, by default 1. `robots` is a number, by default 1;
    `unit` is `s` or `steps`, by default `s`; `adversary` is `blind` or `watcher`.

    A game, written and read:

        >>> from jaxcell import examples, patrol
        >>> path = examples.folder() / "game.json"
        >>> line = patrol.Graph([[0, 1], [1, 2]])
        >>> patrol.rounds.save_game(patrol.rounds.Game.of(line, 3.0), path)
        >>> patrol.rounds.load_game(path).attack.tolist()
        [3.0, 3.0, 3.0]
    """
    path = Path(path)
    check_file(path, "a game")
    with about(path):
        document = decode_json(read_text(path), "a game")
        if not isinstance(document, dict):
            raise ValueError(f"expected an object, got {reprlib.repr(document)}")
        fields = Fields(document)
        fields.check_version(1)
        for part, known in _KNOWN.items():
            for one in fields.parts(part) if part else [fields]:
                for name in one.values:
                    for parts, hint in _ELSEWHERE.items():
                        if name not in known and any(each in name for each in parts.split()):
                            raise ValueError(f"{one.where}{name}: a game has no such field; {hint}")
                one.check_names(known)
        vertices = fields.parts("vertices")
        names = tuple(vertex.text("name") for vertex in vertices)
        if len(set(names)) < len(names) or len(names) < 2:
            raise ValueError("vertices: expected two or more names, all different")
        number = {name: vertex for vertex, name in enumerate(names)}

        def vertex(part: Fields, field: str) -> int:
            if (name := part.text(field)) not in number:
                raise refused(part.where + field, "the name of a vertex", name)
            return number[name]

        def positive(part: Fields, field: str) -> float:
            if (value := part.number(field)) <= 0:
                raise refused(part.where + field, "more than 0", value)
            return value

        shortest: dict[tuple[int, int], float] = {}
        ways = fields.parts("ways")
        loops = 0
        for way in ways:
            ends, time = (vertex(way, "from"), vertex(way, "to")), positive(way, "time")
            if ends[0] == ends[1]:
                loops += 1
            else:
                shortest[ends] = min(time, shortest.get(ends, time))
        targets = fields.parts("targets")
        if not shortest or not targets:
            raise ValueError("expected at least one way between two vertices, and one target")
        for field, choices in _CHOICES.items():
            if document.get(field, choices[0]) not in choices:
                raise refused(field, " or ".join(choices), document[field])
        chosen = [vertex(target, "vertex") for target in targets]
        if len(set(chosen)) < len(chosen):
            raise ValueError("targets: expected each vertex once")
        placed = any("x" in vertex.values for vertex in vertices)
        return Game(
            names=names,
            ends=np.array([*shortest]),
            times=np.array([*shortest.values()]),
            targets=np.array(chosen),
            attack=np.array([positive(target, "attack_time") for target in targets]),
            value=np.array(
                [positive(one, "value") if "value" in one.values else 1.0 for one in targets]
            ),
            robots=fields.whole("robots", 1, 10_000) if "robots" in document else 1,
            unit=document.get("unit", "s"),
            adversary=document.get("adversary", "blind"),
            xy=np.array([[v.number("x"), v.number("y")] for v in vertices]) if placed else None,
            omitted=about_omitted(loops, len(ways) - loops - len(shortest)),
        )
