import os
import textwrap

import numpy as np

from ...base.optional_modules import import_module
from ...base.paths import replacing
from ...drift import Dropped, Released
from ...drift.positions import in_degrees
from ..canvas.palette import BLACK, GOAL, ROBOT
from .colors import color_of
from .ground import beside
from .plot import plot


# The number of letters of a line above the picture.
_LETTERS = 110


def save_sea(found: Dropped | Released, path: str | os.PathLike[str]) -> None:
    """Write a PNG picture of a release and its end, or of drops with their tracks and ends.

    **Arguments:** the result, and the file to write or replace. **Raises:** `ModuleNotFoundError`
    without matplotlib, which `jaxcell[plot]` installs.

    Two drifters in the bundled sea:

        >>> from jaxcell import examples, record, study
        >>> found = study.Deploy(file="@gyres", drop=2, depth=0.0, until=0.1).run()
        >>> record.save_sea(found, examples.folder() / "drops.png")
    """
    figure = import_module("matplotlib.figure").Figure((9, 8), layout="constrained")
    ax = plot(found, ax=figure.add_subplot())
    marks = []
    if isinstance(found, Released):
        marks = [(found.place, "*", ROBOT, "release" if found.tried is None else "find")]
    if isinstance(found, Dropped):
        x, y = found.tracks.x, found.tracks.y
        begin = np.stack([found.water.column, found.water.row])[:, found.cell]
        tracks = (np.concatenate([at[None], on]) for at, on in zip(begin, (x, y), strict=True))
        along, up = in_degrees(found.water, *tracks)
        ax.plot(beside(along, found.lon), up, color=color_of(BLACK), linewidth=0.8)
        marks = [
            ((found.drop_lon, found.drop_lat), "o", ROBOT, "drop"),
            ((found.end_lon, found.end_lat), "s", GOAL, "end"),
        ]
    for (lon, lat), marker, color, label in marks:
        style = {"color": color_of(color), "markeredgecolor": "black", "markersize": 7}
        ax.plot(beside(np.atleast_1d(lon), found.lon), lat, marker, label=label, **style)
    ax.legend()
    ax.set_title("")
    figure.suptitle(textwrap.fill(found.answer[0], _LETTERS), fontsize=10)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=130)
