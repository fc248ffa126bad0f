"""Draw the figures of `drifters.py` that are not in the source: coverage, sensitivity, checks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from jaxcell.drift import CoverageCurve, Water

from ..shared.figures import plt, save
from .drifters_checks import DRIFTERS, Ridges
from .drifters_figures import GROUPS, OTHER, draw_map, height_for, paler, xy
from .drifters_truth import Check


def coverage(curves: dict[str, CoverageCurve], cells: int, path: Path) -> None:
    """Draw the share of visited cells by the number of drifters, for each kind of map."""
    figure, axes = plt.subplots(figsize=(7, 4.4), layout="constrained")
    styles = ("o-", "s-", "^-", "D--", "v--", "x:")
    for place, ((name, curve), style) in enumerate(zip(curves.items(), styles, strict=True)):
        number = np.arange(1, curve.cells.size + 1)
        # The first curves have larger marks, so that they remain visible below the others.
        axes.plot(
            number, 100 * curve.covered / cells, style, lw=1.5, ms=12 - 1.5 * place, label=name
        )
    axes.set(xscale="log", ylim=(0, 103))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set(xlabel="drifters", ylabel="cells that may be visited (%)")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, title="map", loc="lower right")
    save(figure, path)


def sensitivity(by_step: Sequence[dict], by_rho: Sequence[dict], path: Path) -> None:
    """Draw groups, drift and absorption times by the step and by rho."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.2), layout="constrained")
    factor = [row["step"] for row in by_step]
    for name, label, style in (
        ("persistent", "as in the source", "o-"),
        ("rho = 1", "without disturbances", "s--"),
        ("points", "points of the cell", "^:"),
    ):
        left.plot(factor, [row[name] for row in by_step], style, label=label)
    left.set(xlabel="step, of the time to cross a cell", ylabel="persistent groups")
    left.set(yscale="log", title="Groups by the step")
    left.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    left.legend(frameon=False, fontsize=8)
    middle.plot(factor, [row["drift, cells"] for row in by_step], "o-", label="mean drift (cells)")
    middle.plot(
        factor, [row["self, %"] / 100 for row in by_step], "s--", label="share of self-images"
    )
    middle.set(xlabel="step, of the time to cross a cell", ylim=(0, None), title="The grid")
    middle.legend(frameon=False, fontsize=8)
    rho = [row["rho"] for row in by_rho]
    for name, style in (("median, h", "o-"), ("longest, h", "s--")):
        right.plot(rho, [row[name] for row in by_rho], style, label=f"absorption time, {name}")
    right.set(xlabel="probability rho of the image", title="Time by rho")
    right.set_ylabel("hours")
    if all(row["median, h"] > 0 for row in by_rho):
        right.set_yscale("log")
        right.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        right.yaxis.set_minor_formatter(NullFormatter())
    right.legend(frameon=False, fontsize=8)
    save(figure, path)


def replays(water: Water, checks: Sequence[Check], path: Path) -> None:
    """Draw the distributions of two maps, and of simulated drifters below them."""
    shown = (checks[0], checks[2])
    width, across = 3.6, len(checks[0].hours)
    height = 2 * len(shown) * height_for(water, width, 4.5) + 1.2
    figure, panels = plt.subplots(
        2 * len(shown), across, figsize=(across * width, height), layout="constrained"
    )
    for number, check in enumerate(shown):
        rows = panels[2 * number : 2 * number + 2]
        for place, both in enumerate(zip(check.by_map, check.simulated, strict=True)):
            most = np.quantile(np.concatenate(both), 0.995)
            scale = {"cmap": "magma_r", "vmin": 0, "vmax": most}
            for axes, one, name in zip(rows[:, place], both, ("map", "drifters"), strict=True):
                draw_map(axes, water, np.where(one > 0.5 / DRIFTERS, one, np.nan), **scale)
                axes.set(xticks=[], yticks=[])
                axes.set_title(f"{name}, {check.hours[place]:.3g} h", fontsize=9, pad=2)
            rows[1, place].set_xlabel(
                f"{100 * check.wrong[place]:.0f} % in a wrong cell, "
                f"distance {check.apart[place]:.2f} cells",
                fontsize=8,
            )
        rows[0, 0].set_ylabel(check.name.split(",")[0], fontsize=10)
        rows[1, 0].set_ylabel("simulated", fontsize=10)
    save(figure, path)


def ridges(found: Sequence[Ridges], path: Path) -> None:
    """Draw the Lyapunov exponent, and its ridges on the groups."""
    width = 6.2
    height = sum(0.85 * height_for(one.water, width) for one in found) + 1.0
    figure, panels = plt.subplots(
        len(found), 2, figsize=(2 * width, height), layout="constrained", squeeze=False,
        height_ratios=[height_for(one.water, width) for one in found],
    )  # fmt: skip
    for (left, right), one in zip(panels, found, strict=True):
        image = draw_map(left, one.water, one.exponent, cmap="viridis")
        figure.colorbar(image, ax=left, shrink=0.8, label="per hour")
        left.set_title(f"{one.name}: finite-time Lyapunov exponent", fontsize=10)
        labels, size = np.unique(one.label[one.label >= 0], return_counts=True)
        colors = np.ones((one.water.cells, 3))
        largest = labels[np.argsort(-size, kind="stable")]
        for place, label in enumerate(largest):
            color = GROUPS[place] if place < len(GROUPS) else OTHER
            colors[one.label == label] = paler(color, 0.5)
        draw_map(right, one.water, colors)
        right.plot(*xy(one.water, one.ridge), "s", color="black", ms=3)
        right.set_title(
            f"{one.name}: final groups of drifters (white: several), and ridges", fontsize=10
        )
    save(figure, path)
