"""Pictures of the rounds of guards."""

import os
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...base.optional_modules import import_module
from ...base.paths import replacing
from ..canvas.palette import FREE, PLAIN, TARGET, robot_color
from .colors import color_of


if TYPE_CHECKING:
    from ...patrol.rounds import Game, Guarded


# Largest number of names in a picture.
MAX_NAMES = 60
# Distance of a line from its way, relative to the size of the graph.
_ASIDE = 0.008
# Number of letters in a line of the title.
_WIDTH = 112


def places(game: "Game") -> Float[np.ndarray, "vertices 2"]:
    """Return the positions of vertices; vertices without positions form a circle."""
    if game.xy is not None:
        return game.xy
    turn = 2 * np.pi * np.arange(len(game.names)) / len(game.names)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def tours(guarded: "Guarded") -> list[list[int]]:
    """List the guards of each tour, who visit the same vertices in rounds of one duration."""
    found: dict[tuple[float, bytes], list[int]] = {}
    for robot, route in enumerate(guarded.routes):
        key = round(route.period, 6), np.unique(route.vertex).tobytes()
        found.setdefault(key, []).append(robot)
    return list(found.values())


def save_rounds(guarded: "Guarded", path: str | os.PathLike[str]) -> None:
    """Write a PNG picture of rounds, with the guards at the start, and targets by risk.

    A tour has a colour, and lines with arrows on the right of its ways. The colour of a target is
    the share of moments at which an attack there succeeds.

    **Arguments:** the guards, and the file to write or replace. **Raises:** `ModuleNotFoundError`
    without matplotlib, which `jaxcell[plot]` installs.

    Two guards of eight vertices:

        >>> from jaxcell import examples, record, study
        >>> guarded = study.PatrolGuard("@eight", robots=2, attack_time=6.0).run()
        >>> record.save_rounds(guarded, examples.folder() / "rounds.png")
    """
    figure = import_module("matplotlib.figure").Figure(layout="constrained")
    ax = figure.add_subplot()
    game, xy = guarded.game, places(guarded.game)
    named = len(game.names) <= MAX_NAMES
    wide, high = np.ptp(xy, axis=0).tolist()
    figure.set_size_inches(9, 2 + 7 * min(max(high / (wide or 1.0), 0.3), 1.5))
    lines = import_module("matplotlib.collections").LineCollection
    ax.add_collection(lines(xy[game.ends], colors=[color_of(PLAIN)], linewidths=1, zorder=1))
    for tour, robots in enumerate(tours(guarded)):
        color = color_of(robot_color(tour)[1])
        route = guarded.routes[robots[0]]
        legs = np.stack([route.vertex, np.roll(route.vertex, -1)], axis=1)
        legs = np.unique(legs[legs[:, 0] != legs[:, 1]], axis=0)
        ahead = xy[legs[:, 1]] - xy[legs[:, 0]]
        length = np.maximum(np.hypot(*ahead.T), np.finfo(float).tiny)[:, None]
        aside = _ASIDE * max(wide, high) * ahead[:, ::-1] * [1, -1] / length
        sides = xy[legs] + aside[:, None]
        who = ", ".join(str(robot + 1) for robot in robots)
        label = f"guard {who}" if len(robots) == 1 else f"guards {who}, evenly spaced"
        if len(legs):
            label += f": a round in {np.ceil(10 * route.period - 1e-6) / 10:,g} {game.unit}"
            ax.quiver(
                *sides.mean(axis=1).T,
                *(ahead / length).T,
                color=color,
                pivot="mid",
                angles="xy",
                scale=60,
                width=0.0035 if named else 0.0025,
                headwidth=4.5,
                headaxislength=4,
                headlength=4,
                zorder=3,
            )
        ax.add_collection(lines(sides, colors=[color], linewidths=1.8, label=label, zorder=2))
        for robot in robots:
            box = {"boxstyle": "square,pad=0.25", "facecolor": color, "edgecolor": "black"}
            style = {"ha": "center", "va": "center", "color": "white", "fontsize": 8, "zorder": 7}
            ax.text(*start(guarded, robot), str(robot + 1), bbox=box, **style)
    shade = import_module("matplotlib.colors").LinearSegmentedColormap.from_list
    share, at = 100 * guarded.evaluation.exposure, xy[game.targets]
    ends, style = (
        [color_of(FREE), color_of(TARGET)],
        {"s": 60 if named else 15, "edgecolor": "black", "zorder": 4},
    )
    if share.any():
        marks = ax.scatter(
            *at.T, c=share, cmap=shade("risk", ends), vmin=0, label="target", **style
        )
        figure.colorbar(marks, ax=ax, label="moments at which an attack succeeds (%)", shrink=0.7)
    else:
        ax.scatter(*at.T, color=color_of(FREE), label="target: no attack succeeds", **style)
    if named:
        for name, place in zip(game.names, xy.tolist(), strict=True):
            ax.annotate(name, place, (9, 7), textcoords="offset points", fontsize=8, zorder=6)
    title = "\n".join(fill(line.replace("`", ""), _WIDTH) for line in guarded.answer[:2])
    ax.set_aspect("equal")
    ax.margins(0.08)
    ax.set_title(title, fontsize=9)
    ax.set(xlabel="x (m)", ylabel="y (m)")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    if game.xy is None:
        ax.set_axis_off()
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=130)


def start(guarded: "Guarded", robot: int, time: float = 0.0) -> Float[np.ndarray, "2"]:
    """Return the position of a guard at a time, on the straight line between two vertices."""
    route, xy = guarded.routes[robot], places(guarded.game)
    times = np.stack([route.arrive, route.leave], axis=1).ravel()
    at = xy[np.repeat(route.vertex, 2)]
    return np.array([np.interp(time, times, axis, period=route.period) for axis in at.T])
