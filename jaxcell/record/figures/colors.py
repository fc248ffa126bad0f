"""Colours for the numbers of a plot, with a legend or a colour bar."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.quantities import Quantity
from ..canvas.palette import PLAIN, RANKED, TRAIL, Color, ramp


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def color_of(color: Color) -> tuple[float, ...]:
    """Convert a colour with channels from 0 to 255 for matplotlib, where they are from 0 to 1."""
    return tuple(channel / 255 for channel in color)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """An array to draw, with the description of its quantity."""

    about: Quantity
    dims: tuple[str, ...]
    values: np.ndarray

    @property
    def label(self) -> str:
        """The label of an axis or colour bar: the units or, without units, a word like `share`."""
        kinds = {"share": "share", "distribution": "share", "count": "number"}
        return self.about.label or kinds.get(self.about.kind, "")

    def show(self, ax: "Axes", draw: Callable[[np.ndarray, dict[str, Any]], Any]) -> None:
        """Draw the numbers as colours, and add a colour bar or a legend.

        `draw` is called with an array and with options of matplotlib that colour it. An index or a
        flag is replaced by its rank, 0 for the most frequent value, which is first in the legend.
        """
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Patch

        if self.about.kind not in ("index", "flag") or self.about.units is not None:
            values = np.ma.masked_invalid(self.values.astype(float))
            if self.about.kind == "index":
                values = np.ma.masked_less(values, 0)
            shades = ListedColormap(ramp(np.linspace(0, 1, 256)) / 255, "jaxcell")
            ax.figure.colorbar(draw(values, {"cmap": shades}), ax=ax, label=self.label)
            return
        labels, inverse, count = np.unique(self.values, return_inverse=True, return_counts=True)
        own = labels >= 0
        order = np.argsort(np.where(own, -count, 1), kind="stable")
        rank = np.argsort(order)
        # With more values than colours, the rarest are grey.
        named = len(RANKED) if own.sum() <= len(RANKED) else len(RANKED) - 1
        colors = [
            color_of((RANKED[k] if k < named else TRAIL) if own[label] else PLAIN)
            for k, label in enumerate(order)
        ]
        words = {0: "no", 1: "yes"} if self.about.kind == "flag" else {-1: "none", -2: "none"}
        names = {
            words.get(int(labels[label]), str(labels[label])): colors[k]
            for k, label in enumerate(order)
            if k < named or not own[label]
        }
        if own.sum() > named:
            names[f"{own.sum() - named:,} more"] = color_of(TRAIL)
        options = {"cmap": ListedColormap(colors), "vmin": -0.5, "vmax": len(colors) - 0.5}
        draw(np.ma.masked_array(rank[inverse].reshape(self.values.shape)), options)
        if names:
            patches = [Patch(color=color, label=name) for name, color in names.items()]
            ax.legend(handles=patches, loc="center left", bbox_to_anchor=(1, 0.5))
