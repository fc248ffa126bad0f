"""Pictures of the rounds of guards."""

import os
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...base.optional_modules import import_module
from ...base.paths import replacing
from ..canvas.palette import FREE, PLAIN, TARGET, robot_color
from .colors import color_of


if TYPE_CHECKING:
    from ...patrol.rounds import Game, Guarded


# Largest number of names in a picture, and of moments in which a guard is drawn.
MAX_NAMES = 60


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
    """Write a PNG picture of rounds: a colour per tour, targets, and the guards at the start.

    A target is pink if attacks on it can succeed at some moments.

    **Arguments:** the guards, and the file to write or replace. **Raises:** `ModuleNotFoundError`
    without matplotlib, which `jaxcell[plot]` installs.

    Two guards of eight vertices:

        >>> from jaxcell import examples, record, study
        >>> guarded = study.PatrolGuard("@eight", robots=2, attack_time=6.0).run()
        >>> record.save_rounds(guarded, examples.folder() / "rounds.png")
    """
    from pathlib import Path

    figure = import_module("matplotlib.figure").Figure(layout="constrained")
    ax = figure.add_subplot()
    game, xy = guarded.game, places(guarded.game)
    wide, high = np.ptp(xy, axis=0).tolist()
    figure.set_size_inches(9, 2 + 8 * min(max(high / (wide or 1.0), 0.3), 1.5))
    lines = import_module("matplotlib.collections").LineCollection
    ax.add_collection(lines(xy[game.ends], colors=[color_of(PLAIN)], linewidths=1, zorder=1))
    for tour, robots in enumerate(tours(guarded)):
        name, color = robot_color(tour)
        way = xy[np.append(guarded.routes[robots[0]].vertex, guarded.routes[robots[0]].vertex[0])]
        who = ", ".join(str(robot + 1) for robot in robots)
        label = f"guard {who}" if len(robots) == 1 else f"guards {who}, evenly spaced"
        ax.plot(*way.T, color=color_of(color), linewidth=4, alpha=0.6, zorder=2, label=label)
        starts = np.array([start(guarded, robot) for robot in robots])
        ax.plot(*starts.T, "s", color=color_of(color), markeredgecolor="black", zorder=5)
    exposed = guarded.evaluation.exposure > 0
    at = xy[game.targets]
    for which, color, what in (
        (~exposed, FREE, "safe"),
        (exposed, TARGET, "attacks can succeed at some moments"),
    ):
        style = {"color": color_of(color), "markeredgecolor": "black", "zorder": 4}
        if which.any():
            ax.plot(*at[which].T, "o", markersize=7, label=what, **style)
    if len(game.names) <= MAX_NAMES:
        for name, (x, y) in zip(game.names, xy.tolist(), strict=True):
            ax.annotate(name, (x, y), (4, 6), textcoords="offset points", fontsize=8, zorder=6)
    ax.set_aspect("equal")
    ax.set_title(guarded.answer[0], wrap=True, fontsize=10)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=2, fontsize=8)
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
