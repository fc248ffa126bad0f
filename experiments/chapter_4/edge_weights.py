"""Draw edge weights, for several experiments of chapter 4."""

from collections.abc import Collection

import numpy as np
from matplotlib.collections import LineCollection

from jaxcell.patrol import Graph

from ..shared.figures import plt


MARKED = "#d55e00"


def draw_weights(
    axes: plt.Axes,
    graph: Graph,
    weights: np.ndarray,
    marked: Collection[int] = (),
    *,
    widest: float = 8,
    diameter: float = 17,
) -> None:
    """Draw a graph with the width and the colour of each edge by its weight.

    **Arguments:**

    - `graph`: a graph whose vertices have positions.
    - `weights`: array `[edges]`.
    - `marked`: vertices to highlight.
    - `widest`: width in points of the edge with the largest weight.
    - `diameter`: diameter of the vertices in points; from 10 on they contain their numbers.
    """
    share = weights / weights.max()
    order = np.argsort(share)
    lines = LineCollection(
        graph.xy[graph.edges[order]],
        linewidths=np.maximum(widest * share[order], 0.5),
        colors=plt.get_cmap("Blues")(0.3 + 0.65 * share[order]),
        capstyle="round",
        clip_on=False,
        zorder=1,
    )
    axes.add_collection(lines)
    x, y = graph.xy.T
    of_vertex = [MARKED if v in marked else "0.25" for v in range(graph.vertices)]
    dots = axes.scatter(x, y, diameter**2, of_vertex, edgecolors="white", linewidths=0.8, zorder=2)
    dots.set_clip_on(False)
    if diameter >= 10:
        look = {"color": "white", "fontsize": 0.55 * diameter, "zorder": 3}
        for v, at in enumerate(graph.xy):
            axes.annotate(f"{v + 1}", at, ha="center", va="center_baseline", **look)
    axes.set_aspect("equal")
    axes.margins(0.1)
    axes.axis("off")
