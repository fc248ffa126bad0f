import numpy as np
import rerun as rr

from ...patrol.rounds import Guarded
from ..canvas.marks import LABEL, log_lines, log_walker
from ..canvas.page import log_tab
from ..canvas.palette import FREE, PLAIN, TARGET, Color, robot_color
from ..canvas.prose import Spec, described, made_with, numbers
from ..canvas.stream import plane, send_blueprint, send_changing
from ..figures.rounds import MAX_NAMES, places, start, tours


# Number of moments in the longest round.
_MOMENTS = 400


def log_rounds(stream: rr.RecordingStream, guarded: Guarded, spec: Spec) -> None:
    """Record the rounds of guards over the timeline `step`, which divides the longest round."""
    game, xy = guarded.game, places(guarded.game)
    low, high = xy.min(axis=0), xy.max(axis=0)
    extent = float((high - low).max()) or 1.0
    mark = 0.012 * extent
    stream.log("map", rr.Transform3D(scale=[1, -1, 1]), static=True)
    log_lines(stream, "map/ways", list(xy[game.ends]), PLAIN, 1.0, 1.0)
    legend: list[tuple[str, Color]] = []
    longest = max(route.period for route in guarded.routes)
    moments = np.linspace(0, longest, _MOMENTS, endpoint=False)
    for tour, robots in enumerate(tours(guarded)):
        _, color = robot_color(tour)
        vertex = guarded.routes[robots[0]].vertex
        log_lines(
            stream, f"map/rounds/{tour}", [xy[np.append(vertex, vertex[0])]], color, 3.0, 10.0
        )
        for robot in robots:
            place = np.array([start(guarded, robot, time) for time in moments])
            log_walker(stream, f"map/guards/{robot}", place, color, 1.5 * mark, width=2.0, rim=3.5)
        legend.append((f"guard {', '.join(str(robot + 1) for robot in robots)}", color))
    legend += [
        ("a target where no attack can succeed now", FREE),
        ("an attack can succeed", TARGET),
    ]
    _log_targets(stream, guarded, moments, mark)
    text = rr.Points2D(
        xy - [0, mark], labels=game.names, **{**LABEL, "show_labels": len(xy) <= MAX_NAMES}
    )
    stream.log("map/names", text, static=True)
    margin = 0.06 * extent
    box = (low[0] - margin, -high[1] - margin, high[0] + margin, -low[1] + margin)
    view = plane("/", "The rounds", [float(side) for side in box], ["/map/**"])
    tab = log_tab(stream, "", "The rounds", view, _text(guarded, spec), legend)
    send_blueprint(stream, [tab], "step", _MOMENTS / 40)


def _log_targets(
    stream: rr.RecordingStream, guarded: Guarded, moments: np.ndarray, mark: float
) -> None:
    """Log targets, pink at the moments from which no guard comes before an attack is over."""
    game, colors = guarded.game, []
    for target, attack in zip(game.targets.tolist(), game.attack.tolist(), strict=True):
        wait = np.full(moments.size, np.inf)
        for route in guarded.routes:
            for at in np.flatnonzero(route.vertex == target):
                since = (moments - route.arrive[at]) % route.period
                there = since <= route.leave[at] - route.arrive[at]
                wait = np.minimum(wait, np.where(there, 0.0, route.period - since))
        late = wait > attack * (1 + 1e-9)
        colors.append(np.where(late[:, None], TARGET[:3], FREE[:3]))
    times, at = np.arange(moments.size), places(game)[game.targets]
    counts = np.full(moments.size, len(at))
    style = {"radii": mark, "draw_order": 20}
    shown = np.stack(colors, axis=1).reshape(-1, 3).astype(np.uint8)
    positions = np.tile(at, (moments.size, 1))
    send_changing(
        stream,
        "map/targets",
        rr.Points2D,
        times,
        counts,
        style=style,
        positions=positions,
        colors=shown,
    )


def _text(guarded: Guarded, spec: Spec) -> str:
    answer = "\n\n".join(guarded.answer)
    columns = "target", "attack_time", "between", "exposure", "visitors"
    return f"""# Rounds of guards

{answer}

## How to look

Press play, or drag `step` at the bottom: it divides the longest round into {_MOMENTS} parts. A
target is pink while an attack that begins then succeeds.

## Numbers

{numbers(guarded)}

{described(guarded, *columns)}

{made_with(spec)}"""
