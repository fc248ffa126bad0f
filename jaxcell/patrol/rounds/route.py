import csv
import dataclasses
import json
import os
import reprlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...base.documents import Fields, about, check_file, decode_json, read_text, refused
from ...base.paths import replacing
from .game import Game


# Tolerance of a travel time, relative.
_TIME = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """The visits of a robot, which repeat after a period.

    A robot that goes to and fro between two vertices:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> begins = np.array([0.0, 5.0])
        >>> patrol.rounds.Route(np.array([0, 1]), begins, begins, 10.0).period
        10.0
    """

    vertex: Int[np.ndarray, "visits"]
    "The visited vertices in order, without the first again at the end."
    arrive: Float[np.ndarray, "visits"]
    "When the robot arrives, from 0 to the period."
    leave: Float[np.ndarray, "visits"]
    "When the robot leaves."
    period: float

    def check(self, game: Game, where: str) -> None:
        """Raise `ValueError` unless a robot of the game can follow the route."""
        sizes = {self.vertex.size, self.arrive.size, self.leave.size}
        if len(sizes) > 1 or not self.vertex.size or not 0 < self.period < np.inf:
            raise ValueError(f"{where}: expected visits, two times for each, and a period above 0")
        if not ((self.vertex >= 0) & (self.vertex < len(game.names))).all():
            raise ValueError(f"{where}: expected vertices from 0 to {len(game.names) - 1}")
        times = {(a, b): t for (a, b), t in zip(game.ends.tolist(), game.times, strict=True)}
        there, after = np.roll(self.vertex, -1), np.roll(self.arrive, -1)
        after[-1] += self.period
        for i, (here, end) in enumerate(zip(self.vertex.tolist(), there.tolist(), strict=True)):
            begins = f"{where}.visits[{i}]: "
            if not self.arrive[i] <= self.leave[i] <= after[i] + _TIME * self.period:
                raise ValueError(f"{begins}times decrease, or are beyond the period")
            if here == end:
                continue
            names = f"{game.names[here]!r} to {game.names[end]!r}"
            if (here, end) not in times:
                raise ValueError(f"{begins}there is no way from {names}")
            if after[i] - self.leave[i] < times[here, end] * (1 - _TIME):
                raise ValueError(
                    f"{begins}from {names} takes {times[here, end]:g} {game.unit}, and the robot "
                    f"has {after[i] - self.leave[i]:g}"
                )


def save_routes(game: Game, routes: Sequence[Route], path: str | os.PathLike[str]) -> None:
    """Write the routes of robots as JSON, with the positions of vertices, if there are any."""
    robots = []
    for route in routes:
        visits = []
        for vertex, *times in zip(
            route.vertex.tolist(), route.arrive.tolist(), route.leave.tolist(), strict=True
        ):
            visit = {
                "vertex": game.names[vertex],
                **dict(zip(("time", "until"), times, strict=True)),
            }
            if game.xy is not None:
                visit |= dict(zip("xy", game.xy[vertex].tolist(), strict=True))
            visits.append(visit)
        robots.append({"period": route.period, "visits": visits})
    document = {"version": 1, "kind": "rounds", "unit": game.unit, "robots": robots}
    with replacing(Path(path)) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def load_routes(path: str | os.PathLike[str], game: Game) -> tuple[Route, ...]:
    """Read the routes of robots, and check that they can follow them.

    The file is a JSON object; its list `robots` has objects with a `period` and a list of
    `visits`, each with a `vertex`, a `time`, and the time `until` which the robot stays, by
    default the same. The unit of time is that of the game.

    A route on a line, written and read:

        >>> from jaxcell import examples, patrol
        >>> game = patrol.rounds.Game.of(patrol.Graph([[0, 1], [1, 2]]), 4.0)
        >>> path = examples.folder() / "strategy.json"
        >>> routes = patrol.rounds.best_rounds(game).routes
        >>> patrol.rounds.save_routes(game, routes, path)
        >>> patrol.rounds.load_routes(path, game)[0].vertex.tolist()
        [0, 1, 2, 1]
    """
    path = Path(path)
    check_file(path, "a strategy")
    number = {name: vertex for vertex, name in enumerate(game.names)}
    with about(path):
        document = decode_json(read_text(path), "a strategy")
        if not isinstance(document, dict):
            raise ValueError(f"expected an object, got {reprlib.repr(document)}")
        routes = []
        for robot in Fields(document).parts("robots"):
            period, visits = robot.number("period", 0.0), robot.parts("visits")
            if not visits or not period:
                raise ValueError(f"{robot.where}visits: expected a period above 0, and visits")
            for visit in visits:
                if visit.get("vertex") not in number:
                    raise refused(f"{visit.where}vertex", "a vertex", visit.get("vertex"))
            arrive = [visit.number("time", 0.0) for visit in visits]
            leave = [
                visit.number("until" if "until" in visit.values else "time") for visit in visits
            ]
            at = [number[visit.get("vertex")] for visit in visits]
            routes.append(Route(np.array(at), np.array(arrive), np.array(leave), period))
            routes[-1].check(game, robot.where.rstrip("."))
        if len(routes) != game.robots:
            raise ValueError(f"robots: expected {game.robots}, as in the game, got {len(routes)}")
        return tuple(routes)


def save_timetable(
    game: Game, routes: Sequence[Route], path: str | os.PathLike[str], duration: float
) -> None:
    """Write all visits of a night in order of time, as CSV: robot, time, vertex, until.

    Times are in the unit of the game, from 0 to `duration`; robots are numbered from 1. In seconds,
    a column `clock` has hours, minutes and seconds. At time 0 a robot is where its route then is:
    at a vertex or on the way to its first one.
    """
    rows: list[tuple[float, int, int, float]] = []
    for robot, route in enumerate(routes, 1):
        begins = np.arange(0, duration + route.period, route.period)[:, None]
        arrive, leave = (begins + route.arrive).ravel(), (begins + route.leave).ravel()
        vertex = np.tile(route.vertex, len(begins))
        now = arrive <= duration
        rows += zip(
            arrive[now].tolist(),
            [robot] * int(now.sum()),
            vertex[now].tolist(),
            leave[now].tolist(),
            strict=True,
        )
    with replacing(Path(path)) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        clock = game.unit == "s"
        table.writerow(
            ["robot", f"time_{game.unit}", "vertex", f"until_{game.unit}", *["clock"] * clock]
        )
        for time, who, at, until in sorted(rows):
            seconds = round(time)
            shown = f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}"
            row = [who, f"{time:.6g}" if not clock else f"{time:.1f}", game.names[at]]
            row += [f"{until:.6g}" if not clock else f"{until:.1f}", *[shown] * clock]
            table.writerow(row)
