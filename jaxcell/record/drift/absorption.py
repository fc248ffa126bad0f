from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ...drift import SeaDrift
from ...drift.results.layer_ends import ALMOST_FOREVER
from ..canvas.palette import FREE, PLAIN, mix
from ..canvas.prose import described
from ..canvas.scale import Scale
from .map import SeaMap


_PERSISTENT = "in a persistent group"
# The median time in hours from which times are shown in days.
_DAYS = 72
_LATE = f"almost forever: over {ALMOST_FOREVER:,} steps"


def log_absorption(maps: Sequence[SeaMap]) -> rrb.Container:
    """Log a tab that shows the expected time until drifters reach a persistent group."""
    drift, layers = maps[0].drift, [map.drift.layers[map.number] for map in maps]
    hours = [np.asarray(layer.begins.hours) for layer in layers]
    late = [layer.almost_forever for layer in layers]
    shown = np.concatenate([t[(t > 0) & ~is_late] for t, is_late in zip(hours, late, strict=True)])
    # The scale is logarithmic, because times span several powers of ten.
    days = shown.size > 0 and float(np.median(shown)) >= _DAYS
    unit, size = ("days", 24.0) if days else ("h", 1.0)
    until = drift.until if isinstance(drift, SeaDrift) else None
    scale = Scale.over(
        np.minimum(shown if shown.size else [size], until or np.inf) / size,
        f"{{}} {unit}".format,
        spaced=np.geomspace,
        special={_PERSISTENT: FREE, _LATE: mix(PLAIN, (0, 0, 0), 0.4)},
        ground="land",
        open=True,
    )
    views = []
    for map, time, is_late in zip(maps, hours, late, strict=True):
        name, special = f"absorption_{map.number}", {_PERSISTENT: time == 0, _LATE: is_late}
        views.append(map.numbers(name, map.title, scale, time / size, special))
    named, caught = [_PERSISTENT], ""
    if np.concatenate(late).any():
        named.append(_LATE)
        caught = (
            f"*Almost forever* is more than {ALMOST_FOREVER:,} steps: take what holds drifters "
            "there for a persistent group."
        )
    columns = "depth", "median_hours", "longest_hours", "almost_for_ever_cells"
    text = f"""# How long it takes

The *absorption time* of a cell is the expected time until a drifter from this cell is in a
persistent group, or off the map. Blue is soon, yellow is late, on a logarithmic scale; persistent
cells are light.

{described(drift.layers, *columns)}

{caught}
"""
    legend = scale.legend(shown=named)
    return maps[0].tab("absorption", "Absorption times", views, text, legend)
