"""Draw the figures of `visibility.py`: covers, policies, and probabilities of capture."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.collections import PolyCollection

from jaxcell.patrol import Graph
from jaxcell.patrol.map import Policy, Reassignment, Regions, Vulnerability
from jaxcell.space import visibility_polygon

from ..shared.figures import plt, save
from .edge_weights import draw_weights
from .visibility_site import REACH, Site


WALL, SIGHT, NEW, STOP = "0.35", "#cfe6f5", "#8cc5e8", "#0072b2"
BASE, BASE_VIEW, CONTACT, BOUNDARY = "#00705a", "#c3efe6", "#d55e00", "#5cb85c"
REGIONS = ("#fdf1d3", "#f6e0ec", "#e3e3f7")
LEAST = "#d7191c"


# Parts of a figure.


def draw_map(axes: plt.Axes, site: Site) -> None:
    workspace = site.cells.workspace
    axes.add_collection(PolyCollection(workspace.obstacles, facecolors=WALL, zorder=1.5))
    ring = np.concatenate([workspace.boundary, workspace.boundary[:1]])
    axes.plot(*ring.T, color=WALL, lw=1.2, zorder=1.5, clip_on=False)
    low, high = ring.min(axis=0), ring.max(axis=0)
    axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.axis("off")


def draw_cells(axes: plt.Axes, site: Site, where: np.ndarray, color: Any) -> PolyCollection:
    """Fill cells; `color` is a colour, or an array `[cells]` of numbers for a colour map."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * site.cells.cell
    squares = PolyCollection(site.graph.xy[where][:, None] + corners, linewidths=0, zorder=0.5)
    if isinstance(color, np.ndarray):
        squares.set_array(color[where])
        squares.set_edgecolor("face")
        squares.set_linewidth(0.3)
    else:
        squares.set_facecolor(color)
    axes.add_collection(squares)
    return squares


def draw_sight(axes: plt.Axes, site: Site, cell: int, color: str) -> None:
    """Fill the area that is visible from a cell."""
    polygon = visibility_polygon(site.cells.workspace, site.graph.xy[cell], REACH)
    for part in shapely.get_parts(polygon):
        axes.fill(*part.exterior.xy, color=color, lw=0, zorder=0.4)


def mark(axes: plt.Axes, site: Site, cell: int, color: str, size: float = 5, **more: Any) -> None:
    axes.plot(*site.graph.xy[cell], "o", color=color, ms=size, mec="white", mew=0.6, **more)


def ring(axes: plt.Axes, site: Site, cell: int, color: str = LEAST, size: float = 12) -> None:
    axes.plot(*site.graph.xy[cell], "o", mfc="none", mec=color, mew=2, ms=size, zorder=3)


def draw_base(axes: plt.Axes, site: Site) -> None:
    if site.regions is not None:
        # The view of the base is drawn below the areas that robots see.
        draw_cells(axes, site, site.regions.view, BASE_VIEW).set_zorder(0.3)
        mark(axes, site, site.regions.base, BASE, 7)


def draw_regions(axes: plt.Axes, site: Site, regions: Regions) -> None:
    draw_cells(axes, site, regions.view, BASE_VIEW)
    for k in range(regions.count):
        draw_cells(axes, site, regions.region == k, REGIONS[k])


# Covers.


def covers(site: Site, titles: Sequence[str], path: Path) -> None:
    """Draw the cells that each cell of the covers adds: Figures 4.7 and 4.8, or 4.10 to 4.12."""
    panels = [p.cover.size + (p.contact is not None) for p in site.policies]
    columns = 6
    lines = [-(-count // columns) for count in panels]
    width, height = np.ptp(site.cells.workspace.boundary, axis=0)
    size = (12, 0.9 + sum(0.35 + 2.05 * n * height / width for n in lines))
    figure = plt.figure(figsize=size, layout="constrained")
    parts = figure.subfigures(len(panels), 1, height_ratios=lines, squeeze=False)[:, 0]
    for part, policy, line, title in zip(parts, site.policies, lines, titles, strict=True):
        part.suptitle(title, fontsize=11)
        every = iter(part.subplots(line, columns, squeeze=False).flat)
        _cover(every, site, policy)
        for axes in every:
            axes.axis("off")
    save(figure, path)


def _cover(panels: Iterator[plt.Axes], site: Site, policy: Policy) -> None:
    own = np.isin(np.arange(site.graph.vertices), policy.cells)
    left = own.copy()
    for number, cell in enumerate(policy.cover):
        axes = next(panels)
        draw_base(axes, site)
        new = left & site.visible[cell]
        left &= ~new
        draw_sight(axes, site, cell, SIGHT)
        draw_cells(axes, site, new, NEW)
        draw_map(axes, site)
        mark(axes, site, cell, STOP, 6)
        axes.set_title(f"{'abcdefghijklmnop'[number]}) {new.sum()} new", fontsize=9, pad=2)
    if policy.contact is not None:
        axes = next(panels)
        draw_base(axes, site)
        draw_cells(axes, site, own, REGIONS[0])
        draw_map(axes, site)
        mark(axes, site, site.regions.base, BASE, 7)
        mark(axes, site, policy.contact, CONTACT, 6)
        axes.set_title("contact cell", fontsize=9, pad=2)


# Policies.


def policies(site: Site, path: Path) -> None:
    """Draw the weights of the edges: Figure 4.9."""
    figure, panels = plt.subplots(1, 2, figsize=(12, 6.6), layout="constrained")
    for i, (axes, policy) in enumerate(zip(panels, site.policies, strict=True)):
        _policy(axes, site, policy)
        axes.set_title(f"{'ab'[i]}) robot {i + 1}, weights up to {policy.weights.max():.3f}")
    figure.suptitle("Two distributed policies, and their covers (Figure 4.9)")
    save(figure, path)


def centralized(site: Site, lost: Reassignment, robot: int, path: Path) -> None:
    """Draw the policies and regions of Figures 4.2 and 4.13, and policies after a robot is lost."""
    figure, panels = plt.subplots(2, 3, figsize=(14, 9), layout="constrained")
    for k, policy in enumerate(site.policies):
        axes = panels[0, k]
        draw_regions(axes, site, site.regions)
        _policy(axes, site, policy)
        axes.set_title(f"{'abc'[k]}) robot {k + 1}, weights up to {policy.weights.max():.3f}")
    axes = panels[1, 0]
    draw_regions(axes, site, site.regions)
    draw_map(axes, site)
    mark(axes, site, site.regions.base, BASE, 10)
    for k, policy in enumerate(site.policies):
        mark(axes, site, policy.contact, CONTACT, 7)
        axes.annotate(
            f"{policy.cells.size} cells",
            site.graph.xy[site.regions.cells(k)].mean(axis=0),
            ha="center",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
        )
    axes.set_title("d) base, its view, regions and contact cells")
    for k, policy in enumerate(lost.policies):
        axes = panels[1, 1 + k]
        draw_regions(axes, site, lost.regions)
        _policy(axes, site, policy)
        axes.set_title(f"{'ef'[k]}) robot {lost.robot[k] + 1}, without robot {robot + 1}")
    figure.suptitle(
        "Three centralized policies (Figure 4.13), and two when a robot is lost\n"
        "blue: cover, orange: contact cell, dark green: base station, pale green: its view"
    )
    save(figure, path)


def _policy(axes: plt.Axes, site: Site, policy: Policy) -> None:
    if site.regions is not None:
        mark(axes, site, site.regions.base, BASE, 9, zorder=4)
    walked = policy.weights > 0
    graph = Graph(site.graph.edges[walked], site.graph.vertices, site.graph.xy)
    draw_weights(axes, graph, policy.weights[walked], widest=9, diameter=0)
    draw_map(axes, site)
    for cell in policy.cover:
        mark(axes, site, cell, STOP, 8, zorder=4)
    if policy.contact is not None:
        mark(axes, site, policy.contact, CONTACT, 8, zorder=4)


# Vulnerability.


def targets(sites: Sequence[Site], vulnerabilities: Sequence[Vulnerability], path: Path) -> None:
    """Draw the cells that see a target, and the first of them on a way: Figures 4.14 and 4.16."""
    figure, panels = plt.subplots(2, 2, figsize=(9.5, 9.2), layout="constrained")
    for line, site, one in zip(panels, sites, vulnerabilities, strict=True):
        for axes in line:
            draw_base(axes, site)
            draw_map(axes, site)
            ring(axes, site, one.target, STOP, 10)
        draw_sight(line[0], site, one.target, NEW)
        inside = one.view & ~one.boundary
        draw_cells(line[1], site, inside, SIGHT)
        draw_cells(line[1], site, one.boundary, BOUNDARY)
        figures = "4.14" if site.regions is None else "4.16"
        line[0].set_title(f"{site.name}: seen from the target (Figure {figures}(a))", fontsize=10)
        line[1].set_title(
            f"{one.view.sum()} cells, of which {one.boundary.sum()} in the boundary ({figures}(b))",
            fontsize=10,
        )
    save(figure, path)


def arrivals(
    sites: Sequence[Site], vulnerabilities: Sequence[Sequence[Vulnerability]], path: Path
) -> None:
    """Draw simulated arrivals, the fit, the exact law, and the errors: Figures 4.15 and 4.17."""
    figure, panels = plt.subplots(
        2, len(sites), figsize=(12, 7.6), layout="constrained", height_ratios=[1.5, 1]
    )
    for column, site, of_site in zip(panels.T, sites, vulnerabilities, strict=True):
        _histogram(column[0], of_site[0])
        number = "4.15" if site.regions is None else "4.17"
        column[0].set_title(f"{site.name}, typical cell (Figure {number})")
        _error(column[1], of_site)
    save(figure, path)


def _histogram(axes: plt.Axes, one: Vulnerability) -> None:
    times = np.asarray(one.arrivals.time)
    last = int(np.quantile(times, 0.98))
    width = max(1, round(last / 50))
    edges = np.arange(0.5, last + width, width)
    density = {"weights": np.full(times.size, 1 / times.size / width)}
    axes.hist(times, edges, color=NEW, **density, label=f"{times.size:,} simulated runs")
    step = np.arange(1, last + 1)
    axes.step(step, one.law[1 : last + 1], where="mid", color="black", lw=1.5, label="exact law")
    if one.fit is not None:
        at = np.linspace(0.5, last, 400)
        axes.plot(at, np.asarray(one.fit.law.pdf(at)), "--", color=CONTACT, lw=2, label="FMKL fit")
    axes.set(xlim=(0, last), yscale="log", ylim=(one.law[last] / 3, 2 * one.law[1:].max()))
    axes.set(xlabel="first arrival (steps)", ylabel="probability of a step")
    axes.legend(frameon=False)


def _error(axes: plt.Axes, of_site: Sequence[Vulnerability]) -> None:
    axes.axhline(0, color="black", lw=1)
    for one, name, style in zip(of_site, ("typical", "weakest"), ("-", ":"), strict=True):
        exact = np.cumsum(one.law)
        step = np.arange(1, exact.size)
        times = np.sort(np.asarray(one.arrivals.time))
        share = np.searchsorted(times, step, side="right") / times.size
        axes.plot(step, share - exact[1:], style, color=STOP, lw=1.3, label=f"simulated, {name}")
        if one.fit is not None:
            fitted = np.asarray(one.fit.law.cdf(step + 0.5))
            axes.plot(step, fitted - exact[1:], style, color=CONTACT, lw=1.6, label=f"fit, {name}")
    axes.set_xscale("log")
    axes.set(xlabel="attack time (steps)", ylabel="difference from\nthe exact law", xlim=(1, None))
    axes.legend(frameon=False, fontsize=8)


def maps(
    sites: Sequence[Site],
    caught: Sequence[np.ndarray],
    titles: Sequence[str],
    attack: int,
    path: Path,
) -> None:
    """Draw the probability of capture at each cell, with a ring around the weakest cell."""
    figure, panels = plt.subplots(1, len(sites), figsize=(15, 5.2), layout="constrained")
    every = np.concatenate([one[s.targets] for s, one in zip(sites, caught, strict=True)])
    for axes, site, one, title in zip(panels, sites, caught, titles, strict=True):
        draw_base(axes, site)
        squares = draw_cells(axes, site, site.targets, one)
        squares.set(cmap="viridis", clim=(every.min(), every.max()))
        draw_map(axes, site)
        worst = int(np.argmin(one))
        ring(axes, site, worst)
        axes.set_title(f"{title}, at least {one[worst]:.3f}", fontsize=10)
    figure.colorbar(
        squares, ax=panels, label=f"probability of capture in {attack} steps", shrink=0.85, pad=0.01
    )
    save(figure, path)


def sweeps(
    by_robots: Sequence[dict[str, Any]],
    by_share: Sequence[dict[str, Any]],
    cells: dict[str, np.ndarray],
    attack: int,
    path: Path,
) -> None:
    """Draw capture by the number of robots, by the share on the tour, and by cell."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
    for axes, rows, x in ((left, by_robots, "robots"), (middle, by_share, "share")):
        at = [row[x] for row in rows]
        for time, color in ((20, CONTACT), (50, STOP)):
            style = {"color": color, "ms": 4}
            mean, least = ([row[f"{of}, {time}"] for row in rows] for of in ("mean", "least"))
            axes.plot(at, mean, "-o", label=f"mean of the cells, {time} steps", **style)
            axes.plot(at, least, "--o", mfc="white", label=f"weakest cell, {time} steps", **style)
        axes.set(ylim=(0, None), ylabel="probability of capture")
    left.set_xticks([row["robots"] for row in by_robots])
    left.set(xlabel="robots", title="Distributed robots, share 0.8")
    left.legend(frameon=False, fontsize=8)
    middle.set(xlabel="least share h of the weight on the tour", title="Two robots, by share")
    for (name, caught), color in zip(cells.items(), ("0.6", CONTACT, STOP), strict=True):
        right.plot(np.arange(1, caught.size + 1), np.sort(caught), color=color, label=name)
    right.set(xlabel="cells, from the weakest", xlim=(1, None))
    right.set_title(f"Cell by cell, {attack} steps")
    right.legend(frameon=False, fontsize=8)
    save(figure, path)
