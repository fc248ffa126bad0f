"""Draw the figures of `drifters.py` for one layer: currents, behaviour, and deployment."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxcell.drift import (
    DriftStep,
    Flow,
    VisibleDeployment,
    Water,
    advect,
    deployment_cells,
    flow_map,
)
from jaxcell.markov import absorption_probabilities

from ..shared.figures import plt, save
from .drifters_sea import Layer


LAND, ARROW, DROPPED = "0.62", "#1f3d5c", "black"
# Colours of persistent groups; transient groups with one domicile have a paler colour.
GROUPS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
OTHER, GONE, SEVERAL = "#60524a", "#ffffff", ("#cdbfe3", "#b39ddb", "#9575cd", "#7e57c2")
PALE = 0.66
SEEN, CAMERA = "#cfe6f5", "#0072b2"
MOST_ARROWS = 40
# The largest residual of probabilities that are good enough for a figure.
FAIR = 1e-3


# Parts of a figure.


def side(water: Water) -> tuple[float, float]:
    """Compute the mean sides of a cell in km."""
    return float(np.nanmean(water.dx) / 1000), float(np.nanmean(water.dy) / 1000)


def size_of(water: Water) -> tuple[float, float]:
    """Compute the width and the height of the map in km."""
    dx, dy = side(water)
    rows, columns = water.number.shape
    return columns * dx, rows * dy


def height_for(water: Water, width: float, most: float = 12.0) -> float:
    """Compute the height of a panel with a map, at most `most`."""
    across, up = size_of(water)
    return min(width * up / across, most)


def xy(water: Water, cells: Any) -> tuple[np.ndarray, np.ndarray]:
    """Compute the centres of cells in km."""
    dx, dy = side(water)
    return (water.column[cells] + 0.5) * dx, (water.row[cells] + 0.5) * dy


def draw_map(axes: plt.Axes, water: Water, colors: np.ndarray | None = None, **more: Any) -> Any:
    """Draw land, and cells in colours `[cells, 3]` or by numbers `[cells]`; return the image."""
    across, up = size_of(water)
    within = {"origin": "lower", "extent": (0, across, 0, up), "interpolation": "nearest"}
    land = np.broadcast_to(to_rgb(LAND), (*water.number.shape, 3)).copy()
    land[water.row, water.column] = 1.0 if colors is None or colors.ndim == 1 else colors
    image = axes.imshow(land, **within)
    if colors is not None and colors.ndim == 1:
        image = axes.imshow(np.ma.masked_invalid(water.on_grid(colors)), **within, **more)
    axes.set(xlim=(0, across), ylim=(0, up), aspect="equal")
    axes.tick_params(labelsize=7, length=2)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], integer=True))
    return image


def draw_arrows(axes: plt.Axes, water: Water, flow: Flow, **more: Any) -> None:
    """Draw the current, with at most `MOST_ARROWS` arrows along a side."""
    every = -(-max(water.number.shape) // MOST_ARROWS)
    some = (water.row % every == every // 2) & (water.column % every == every // 2)
    rate = np.asarray(flow.rate[0])
    u = (rate[0] * water.dx)[water.row, water.column][some]
    v = (rate[1] * water.dy)[water.row, water.column][some]
    typical = np.quantile(np.hypot(u, v), 0.9)
    long = every * side(water)[0]
    look = {"color": ARROW, "width": 0.0028, "headwidth": 4, "zorder": 2} | more
    axes.quiver(*xy(water, some), u, v, scale=typical / long, scale_units="xy", angles="xy", **look)


def group_colors(layer: Layer) -> np.ndarray:
    """Choose a colour for each persistent group; if there are many, the largest have their own."""
    count = layer.behaviour.groups.count
    colors = np.broadcast_to(to_rgb(OTHER), (count, 3)).copy()
    order = np.arange(count)
    if count > len(GROUPS):
        order = np.argsort(-np.asarray(layer.behaviour.groups.size), kind="stable")
    for group, color in zip(order, GROUPS, strict=False):
        colors[group] = to_rgb(color)
    return colors


def paler(color: Any, share: float = PALE) -> np.ndarray:
    return np.asarray(to_rgb(color)) * (1 - share) + share


def part_colors(layer: Layer) -> np.ndarray:
    """Choose a colour for each transient group."""
    groups = group_colors(layer)
    several = 0
    colors = np.ones((layer.behaviour.transient.count, 3))
    for part, homes in enumerate(layer.behaviour.transient.domiciles):
        if len(homes) == 1:
            colors[part] = to_rgb(GONE) if homes[0] < 0 else paler(groups[homes[0]])
        else:
            colors[part] = to_rgb(SEVERAL[several % len(SEVERAL)])
            several += 1
    return colors


def behaviour_colors(layer: Layer) -> np.ndarray:
    """Choose the colour of each cell by its persistent or transient group."""
    group, part = layer.group, layer.transient
    nothing = np.ones((1, 3))
    return np.where(
        (group >= 0)[:, None],
        np.concatenate([group_colors(layer), nothing])[group],
        np.concatenate([part_colors(layer), nothing])[part],
    )


def legend_of(layer: Layer, most: int = 10) -> list[Patch]:
    """Make the entries of a legend; if there are many, the largest groups."""
    sizes = np.asarray(layer.behaviour.groups.size)
    colors = group_colors(layer)
    named = (colors != to_rgb(OTHER)).any(axis=1)
    entries = [
        (int(sizes[group]), f"persistent {group + 1}", colors[group])
        for group in np.flatnonzero(named)
    ]
    if not named.all():
        entries.append((int(sizes[~named].sum()), "other persistent", to_rgb(OTHER)))
    transient = layer.behaviour.transient
    for part, color in enumerate(part_colors(layer)):
        entries.append((int(transient.size[part]), f"leads to {layer.homes(part)}", color))
    if len(entries) > most:
        entries = sorted(entries, key=lambda entry: -entry[0])[:most]
    return [
        Patch(facecolor=color, edgecolor="0.4", lw=0.5, label=f"{name} ({count} cells)")
        for count, name, color in entries
    ]


# Figures 5.6 to 5.9.


def flow(layer: Layer, path: Path) -> None:
    """Draw the current, and the flow lines of a step and of a day."""
    water = layer.water
    width = 5.2
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(3 * width, height_for(water, width) + 0.7), layout="constrained"
    )
    for axes in (left, middle, right):
        draw_map(axes, water)
        axes.set_xlabel("km", fontsize=8)
    draw_arrows(left, water, layer.flow)
    left.set_title("a) current (Figure 5.6(a))")
    shift = np.asarray(flow_map(water, layer.flow, DriftStep(layer.duration)))
    dx, dy = side(water)
    x, y = xy(water, slice(None))
    middle.plot([x, x + shift[0] * dx], [y, y + shift[1] * dy], color=ARROW, lw=0.8)
    middle.plot(x + shift[0] * dx, y + shift[1] * dy, ".", color=GROUPS[1], ms=2.5)
    middle.set_title(f"b) flow lines of {layer.duration / 3600:.2g} h (Figure 5.6(b))")
    xs, ys = _lines(layer, 24 * 3600.0)
    some = (water.row + water.column) % 2 == 0
    right.plot((xs[:, some] + 0.5) * dx, (ys[:, some] + 0.5) * dy, color=ARROW, lw=0.5, alpha=0.6)
    right.plot((xs[-1] + 0.5) * dx, (ys[-1] + 0.5) * dy, ".", color=GROUPS[1], ms=4, zorder=3)
    right.set_title("c) flow lines of a day, and their ends")
    save(figure, path)


def _lines(layer: Layer, seconds: float, pieces: int = 96) -> tuple[np.ndarray, np.ndarray]:
    x, y = (np.asarray(v, float) for v in (layer.water.column, layer.water.row))
    xs, ys = [x], [y]
    for _ in range(pieces):
        x, y = advect(layer.flow, x, y, seconds / pieces, method="rk4")
        xs.append(np.asarray(x))
        ys.append(np.asarray(y))
    return np.stack(xs), np.stack(ys)


def behaviour(layer: Layer, path: Path) -> None:
    """Draw the groups and the deployment cells: Figure 5.7."""
    water = layer.water
    width = 5.6
    figure, panels = plt.subplots(
        1, 2, figsize=(2 * width + 2.6, height_for(water, width) + 0.7), layout="constrained"
    )
    colors = behaviour_colors(layer)
    for axes in panels:
        draw_map(axes, water, colors)
        axes.set_xlabel("km", fontsize=8)
    panels[0].set_title("a) persistent and transient groups (Figure 5.7(a))", fontsize=11)
    chosen = deployment_cells(layer.behaviour).cells
    panels[1].plot(*xy(water, chosen), "o", color=DROPPED, mec="white", mew=0.8, ms=7)
    panels[1].set_title(f"b) {chosen.size} deployment cells (Figure 5.7(b))", fontsize=11)
    figure.legend(handles=legend_of(layer), loc="outside right center", frameon=False, fontsize=9)
    save(figure, path)


def absorption(layer: Layer, path: Path) -> None:
    """Draw absorption times by cell and by group, and final groups: Figure 5.8."""
    water = layer.water
    width = 5.0
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(3 * width, height_for(water, width) + 0.9), layout="constrained"
    )
    persistent = layer.group >= 0
    hours = np.where(persistent, np.nan, layer.hours)
    if np.isfinite(hours).any():
        wide = np.nanmax(hours) > 100 * np.nanmin(hours)
        norm = LogNorm(vmin=np.nanmin(hours), vmax=np.nanmax(hours)) if wide else None
        colored = {"norm": norm} if wide else {"vmin": 0}
        image = draw_map(left, water, hours, cmap="viridis", **colored)
        figure.colorbar(image, ax=left, shrink=0.8, label="hours")
    else:
        draw_map(left, water)
    left.set_title("a) absorption time; groups are white", fontsize=11)
    _by_group(middle, layer)
    middle.set_title("b) by transient group (Figure 5.8)", fontsize=11)
    ends = absorption_probabilities(layer.chain, layer.behaviour.groups, throw=False)
    every = np.concatenate([np.asarray(ends.value), np.asarray(ends.leaving)[None]])
    blend = np.concatenate([group_colors(layer), [to_rgb(GONE)]])
    fair = ends.certificate.residual < FAIR
    draw_map(right, water, np.clip(every.T @ blend, 0, 1) if fair else None)
    how = "mixed by probability" if fair else "beyond 64-bit numbers"
    right.set_title(f"c) final groups of drifters, {how}", fontsize=11)
    save(figure, path)


def _by_group(axes: plt.Axes, layer: Layer, most: int = 10) -> None:
    transient = layer.behaviour.transient
    parts = np.sort(np.argsort(-np.asarray(transient.size), kind="stable")[:most])
    if not parts.size or np.isnan(layer.hours).any():
        why = "no transient cells" if not parts.size else "beyond 64-bit numbers"
        axes.text(0.5, 0.5, why, ha="center", transform=axes.transAxes)
        axes.axis("off")
        return
    hours = [layer.hours[layer.transient == part] for part in parts]
    labels = [layer.homes(part) for part in parts]
    drawn = axes.boxplot(
        hours, tick_labels=labels, whis=(0, 100), patch_artist=True, showmeans=True, widths=0.6,
        medianprops={"color": "black"},
        meanprops={"marker": "D", "mfc": "black", "mec": "white", "ms": 6},
    )  # fmt: skip
    for box, color in zip(drawn["boxes"], part_colors(layer)[parts], strict=True):
        box.set_facecolor(color)
    high = max(one.max() for one in hours)
    if high > 1000 * min(one.min() for one in hours):
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, None)
    axes.set(xlabel="persistent groups that the cells lead to", ylabel="hours (diamond: mean)")


def views(layer: Layer, deployment: VisibleDeployment, reach: float, path: Path) -> None:
    """Draw cells from which cameras see all cells, and their deployment: Figure 5.9."""
    water = layer.water
    width = 5.6
    figure, panels = plt.subplots(
        1, 2, figsize=(2 * width, height_for(water, width) + 0.7), layout="constrained"
    )
    plain = np.broadcast_to(to_rgb(SEEN), (water.cells, 3)).copy()
    for group, color in enumerate(group_colors(layer)):
        plain[layer.group == group] = paler(color, 0.5)
    for axes, cells in zip(panels, (deployment.cover, deployment.cells), strict=True):
        draw_map(axes, water, plain)
        for x, y in zip(*xy(water, cells), strict=True):
            axes.add_patch(
                plt.Circle((x, y), reach / 1000, fc="none", ec=CAMERA, lw=0.8, alpha=0.7)
            )
        axes.plot(*xy(water, cells), "o", color=CAMERA, mec="white", mew=0.8, ms=8)
        axes.set_xlabel("km", fontsize=8)
    panels[0].set_title(f"a) {deployment.cover.size} cells that see all cells (Figure 5.9(a))")
    panels[1].set_title(f"b) {deployment.cells.size} of them for deployment (Figure 5.9(b))")
    save(figure, path)
