from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ...base.formatting import in_time
from ..canvas.palette import FREE
from ..canvas.prose import described
from ..canvas.scale import LEVELS, Scale
from .map import CurrentMap


_UNKNOWN = "no drifter began there"


def log_distances(maps: Sequence[CurrentMap]) -> rrb.Container:
    """Log a tab with the share of drifters from each cell that the chain puts in wrong areas."""
    drift = maps[0].drift
    bounds = np.linspace(0, 100, LEVELS + 1)
    scale = Scale(bounds, "{} %".format, {_UNKNOWN: FREE}, ground="land")
    views = []
    for map in maps:
        by_cell = drift.layers[map.number].by_cell
        assert by_cell is not None
        percent = 100 * by_cell[0]
        name, title = f"distance_{map.number}", f"{map.title}: after {in_time(drift.asked_hours)}"
        views.append(map.numbers(name, title, scale, percent, {_UNKNOWN: np.isnan(percent)}))
    noise = float(np.nanmean(drift.distance_by_cell_noise))
    test = ""
    if drift.markov_test is not None:
        columns = "number", "depth", "hours", "by_map", "by_drifters", "error"
        test = f"""## Sets of cells (Chapman-Kolmogorov)

{described(drift.markov_test, *columns)}
"""
    text = f"""# How sure the map is

Drifters in the current itself begin at many points of each cell. **The map**: the share of the
drifters from each cell for which the map of cells predicts the wrong one of 36 parts of the sea,
after **{in_time(drift.asked_hours)}**. For an exact map it would be {noise:.0%} on average.

{described(drift, "compared_hours", "distance_by_time")}

{test}
"""
    return maps[0].tab("distance", "Distance", views, text, scale.legend(shown=[]))
