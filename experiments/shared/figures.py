"""Set up matplotlib to draw files without a screen, and draw parts that several figures have."""

from pathlib import Path

import matplotlib as mpl
import numpy as np


mpl.use("Agg")

import matplotlib.pyplot as plt


def save(figure: plt.Figure, path: Path, dpi: int = 150) -> None:
    """Write a figure, and free its memory."""
    figure.savefig(path, dpi=dpi)
    plt.close(figure)


def draw_room(axes: plt.Axes, free: np.ndarray, *, grid: bool = False) -> None:
    """Draw the squares `[rows, columns]` of a room, with dark obstacles."""
    rows, columns = free.shape
    extent = (0, columns, 0, rows)
    axes.imshow(free, origin="lower", cmap="gray", vmin=-0.4, vmax=1.05, extent=extent)
    if grid:
        axes.set(xticks=range(columns + 1), yticks=range(rows + 1))
        axes.grid(color="0.85", linewidth=0.6)
        axes.tick_params(length=0, labelbottom=False, labelleft=False)
    else:
        axes.set(xticks=[], yticks=[])


def draw_boxes(axes: plt.Axes, samples: list, color: str, width: float = 0.5, **options) -> list:
    """Draw a box for each array of samples, and return the boxes."""
    median = {"color": "#d55e00", "linewidth": 2}
    outliers = {"marker": ".", "markersize": 5}
    look = {"boxprops": {"facecolor": color}, "medianprops": median, "flierprops": outliers}
    return axes.boxplot(samples, widths=width, patch_artist=True, **look, **options)["boxes"]
