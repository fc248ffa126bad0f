"""Draw the figures of `drifters.py` for several layers: Figures 5.10 to 5.16."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.colors import PowerNorm, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from jaxcell.drift import Voyage, Water, simulate_voyages

from ..shared.figures import plt, save
from .drifters_checks import SAILING, Voyages
from .drifters_figures import (
    GROUPS,
    LAND,
    behaviour_colors,
    draw_arrows,
    draw_map,
    height_for,
    legend_of,
    side,
    size_of,
    xy,
)
from .drifters_sea import Layer, Ocean
from .drifters_tables import Moment


START, REACHED, BOTH, GOAL = "#1b9e3f", "#9fd3f0", "#5fb0dc", "#e31a1c"
UP, DOWN, DRIFT = "#1f4fd8", "#7aa6ff", "#d62728"
ACTIONS = ((-1, "up", "#1f4fd8"), (0, "drift", "#f4c7b8"), (1, "down", "#8fb8ff"))


def _panels(kinds: int, layers: int, width: float, height: float) -> tuple[Any, np.ndarray]:
    """Make panels `[kinds, layers]`; a single layer has its panels side by side."""
    if layers == 1:
        size = (kinds * width, height + 0.8)
        figure, panels = plt.subplots(1, kinds, figsize=size, layout="constrained", squeeze=False)
        return figure, panels.T
    size = (layers * width, kinds * height)
    return plt.subplots(kinds, layers, figsize=size, layout="constrained")


def moment(ocean: Ocean, one: Moment, path: Path) -> None:
    """Draw currents, behaviour and reached cells of all layers at a time: Figures 5.10 to 5.15."""
    count = len(one.layers)
    water = one.layers[0].water
    width = 4.6
    figure, panels = _panels(3, count, width, height_for(water, width, 6.0) + 0.7)
    first = ocean.first
    for k, (column, layer) in enumerate(zip(panels.T, one.layers, strict=True)):
        water = layer.water
        draw_map(column[0], water)
        draw_arrows(column[0], water, layer.flow)
        column[0].set_title(f"{water.depth:g} m", fontsize=11)
        draw_map(column[1], water, behaviour_colors(layer))
        column[1].legend(
            handles=legend_of(layer, 6), loc="upper center", bbox_to_anchor=(0.5, -0.06),
            ncols=2, fontsize=7, frameon=False, handlelength=1.2, columnspacing=1,
        )  # fmt: skip
        inside = slice(first[k], first[k + 1])
        often = np.sum([reached[inside] for reached in one.reached], axis=0)
        colors = np.stack([to_rgb(c) for c in ("white", REACHED, BOTH)])[np.minimum(often, 2)]
        draw_map(column[2], water, colors)
        for start in ocean.starts:
            # The start is marked in each layer that has its square.
            at = one.layers[0].water.row[start], one.layers[0].water.column[start]
            if water.number[at] >= 0:
                column[2].plot(
                    *xy(water, water.number[at]), "s", color=START, mec="white", mew=0.8, ms=7
                )
    for axes, name in zip(panels[:, 0], ("current", "long-term behaviour", "reached"), strict=True):
        axes.set_ylabel(name, fontsize=11)
    hour = ocean.hour(one.record)
    figure.suptitle(
        f"After {hour:g} h (kinds of Figures 5.10 to 5.15); "
        "below, cells that drifters from the green cells reach, darker if both do"
    )
    save(figure, path)


# Figure 5.16.


def voyage(ocean: Ocean, record: int, voyages: Voyages, path: Path) -> None:
    """Draw values, policies and times of each layer."""
    waters = ocean.waters
    first = ocean.first
    width = 4.6
    figure, panels = _panels(4, len(waters), width, height_for(waters[0], width, 6.0) + 0.4)
    hours = voyages.duration / 3600
    times = [np.asarray(v.conditional_time) * hours for v in (voyages.discounted, voyages.surest)]
    reasonable = [np.where(np.isfinite(time), time, np.nan) for time in times]
    latest = np.nanquantile(reasonable[1], 0.95)
    value = np.asarray(voyages.discounted.value)
    for k, (column, water) in enumerate(zip(panels.T, waters, strict=True)):
        inside = slice(first[k], first[k + 1])
        scale = {"cmap": "viridis", "vmin": value.min(), "vmax": value.max()}
        images = [draw_map(column[0], water, value[inside], **scale)]
        column[0].set_title(f"{water.depth:g} m", fontsize=11)
        for axes, policy in ((column[1], voyages.discounted), (column[2], voyages.surest)):
            action = np.asarray(policy.action)[inside]
            draw_map(axes, water, _action_colors(action))
            _drifts(axes, ocean.layer(record, k), action == 0)
        scale = {"cmap": "magma_r", "norm": PowerNorm(0.5, 0, latest)}
        images.append(draw_map(column[3], water, reasonable[1][inside], **scale))
        for axes in column:
            if first[k] <= voyages.goal < first[k + 1]:
                axes.plot(
                    *xy(water, voyages.goal - first[k]),
                    "*",
                    color=GOAL,
                    mec="white",
                    ms=15,
                    zorder=5,
                )
    figure.colorbar(images[0], ax=panels[0], label="value", shrink=0.9, pad=0.01)
    figure.colorbar(
        images[1], ax=panels[3], label="hours, if it arrives", shrink=0.9, pad=0.01, extend="max"
    )
    names = ("value (5.16(b))", "discounted policy (5.16(c))", "surest policy", "its time")
    for axes, name in zip(panels[:, 0], names, strict=True):
        axes.set_ylabel(name, fontsize=11)
    handles = [Patch(color=color, label=name) for _, name, color in ACTIONS]
    handles.append(Line2D([], [], marker="*", color=GOAL, ms=12, ls="", label="goal"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    save(figure, path)


def _action_colors(action: np.ndarray) -> np.ndarray:
    return np.stack([to_rgb(color) for _, _, color in ACTIONS])[action + 1]


def _drifts(axes: plt.Axes, layer: Layer, where: np.ndarray) -> None:
    """Draw arrows of the current in cells where the drifter drifts."""
    water = layer.water
    u, v = (along[where] for along in directions(layer))
    dx = side(water)[0]
    axes.quiver(
        *xy(water, where), u, v, scale=1 / (0.8 * dx), scale_units="xy",
        angles="xy", color=DRIFT, width=0.003, headwidth=4, pivot="mid",
    )  # fmt: skip


def directions(layer: Layer) -> np.ndarray:
    """Compute the unit vectors `[2, cells]` of the current, along the axes of the grid."""
    water = layer.water
    speed = np.asarray(layer.flow.rate[0]) * np.stack([water.dx, water.dy])
    speed = speed[:, water.row, water.column]
    return speed / np.maximum(np.hypot(*speed), 1e-12)


def stack(ocean: Ocean, record: int, voyages: Voyages, seed: int, path: Path) -> None:
    """Draw the layers above each other, with goal, value, policy, and simulated drifters."""
    figure = plt.figure(figsize=(15, 12.5), layout="constrained")
    panels = [figure.add_subplot(2, 2, n + 1, projection="3d") for n in range(4)]
    value = np.asarray(voyages.discounted.value)
    shade = plt.get_cmap("viridis")((value - value.min()) / max(np.ptp(value), 1e-12))[:, :3]
    plain = np.broadcast_to(to_rgb("#dcecf7"), (len(value), 3))
    titles = (
        "a) the layers and the goal (Figure 5.16(a))",
        "b) value (Figure 5.16(b))",
        "c) policy: up and down blue, drift red (Figure 5.16(c))",
        f"d) simulated drifters from the green cells; grey: no arrival in {SAILING} steps",
    )
    for axes, title, colors in zip(panels, titles, (plain, shade, plain, plain), strict=True):
        _layers(axes, ocean, colors, 0.5 if colors is plain else 0.85)
        axes.set_title(title)
        axes.plot(*_place(ocean, voyages.goal), "*", color=GOAL, ms=16, mec="white", zorder=9)
    scale = plt.cm.ScalarMappable(plt.Normalize(value.min(), value.max()), "viridis")
    figure.colorbar(scale, ax=panels[1], label="value", shrink=0.6, pad=0.08)
    _policy(panels[2], ocean, record, voyages.discounted)
    _tracks(panels[3], ocean, voyages, seed)
    save(figure, path)


def _place(ocean: Ocean, cell: int) -> tuple[list, list, list]:
    """Compute the coordinates in a figure of a cell, numbered over all layers."""
    layer = int(np.searchsorted(ocean.first, cell, side="right")) - 1
    x, y = xy(ocean.waters[layer], int(cell - ocean.first[layer]))
    return [x], [y], [-layer]


def _layers(axes: Axes3D, ocean: Ocean, colors: np.ndarray, alpha: float) -> None:
    across, up = size_of(ocean.waters[0])
    for k, water in enumerate(ocean.waters):
        dry = water.number < 0
        row, column = np.nonzero(dry)
        axes.add_collection3d(_squares(water, row, column, k, LAND, 0.6))
        inside = colors[ocean.first[k] : ocean.first[k + 1]]
        axes.add_collection3d(_squares(water, water.row, water.column, k, inside, alpha))
    last = len(ocean.waters) - 1
    axes.set(xlim=(0, across), ylim=(0, up), zlim=(-last - 0.1, 0.1))
    axes.set_box_aspect((across, up, 0.75 * max(across, up)), zoom=1.25)
    axes.set_zticks([-k for k in range(last + 1)], [f"{w.depth:g} m" for w in ocean.waters])
    axes.tick_params(labelsize=7)
    axes.view_init(elev=22, azim=-62)
    axes.grid(visible=False)


def _squares(water: Water, row, column, layer, color, alpha) -> Poly3DCollection:
    dx, dy = side(water)
    corner = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    x, y = (column[:, None] + corner[:, 0]) * dx, (row[:, None] + corner[:, 1]) * dy
    squares = Poly3DCollection(
        np.stack([x, y, np.full_like(x, -layer)], axis=-1), alpha=alpha, linewidths=0
    )
    squares.set_facecolor(color)
    return squares


def _policy(axes: Axes3D, ocean: Ocean, record: int, policy: Voyage) -> None:
    action = np.asarray(policy.action)
    for k, water in enumerate(ocean.waters):
        inside = action[ocean.first[k] : ocean.first[k + 1]]
        dx = side(water)[0]
        x, y = xy(water, slice(None))
        u, v = directions(ocean.layer(record, k))
        level = np.full(x.shape, -float(k))
        here = np.stack([x, y, level], axis=1)
        along = np.stack([dx * u, dx * v, 0 * u], axis=1)
        upright = np.stack([0 * x, 0 * x, -0.45 * inside], axis=1)
        for where, by, color in ((inside == 0, along, DRIFT), (inside != 0, upright, UP)):
            if where.any():
                lines = np.stack([here, here + by], axis=1)[where]
                axes.add_collection3d(Line3DCollection(lines, colors=color, linewidths=0.8))
        axes.scatter(*(here + upright)[inside != 0].T, color=UP, s=4, depthshade=False)


def _tracks(axes: Axes3D, ocean: Ocean, voyages: Voyages, seed: int, drifters: int = 12) -> None:
    """Draw the paths of some drifters, shifted so that paths in one cell remain visible."""
    random = np.random.default_rng(seed)
    waters, first = ocean.waters, ocean.first
    dx, dy = side(waters[0])
    column = np.concatenate([water.column for water in waters])
    row = np.concatenate([water.row for water in waters])
    layer = np.repeat(np.arange(len(waters)), np.diff(first))
    for number, start in enumerate(ocean.starts):
        key = jax.random.fold_in(jax.random.key(seed), number)
        tracks = simulate_voyages(key, voyages.discounted, start, drifters, SAILING)
        for track, time in zip(np.asarray(tracks.cell).T, np.asarray(tracks.time), strict=True):
            way = track[: int(min(time, SAILING)) + 1]
            way = way[way >= 0]
            off = random.uniform(-0.3, 0.3, 2)
            axes.plot(
                (column[way] + 0.5 + off[0]) * dx, (row[way] + 0.5 + off[1]) * dy, -layer[way],
                color=GROUPS[number % len(GROUPS)] if np.isfinite(time) else "0.5", lw=0.9,
            )  # fmt: skip
        axes.plot(*_place(ocean, start), "s", color=START, ms=9, mec="white", zorder=9)
