import numpy as np
import rerun.blueprint as rrb

from ...base.formatting import in_time
from ...drift import Exchange
from ..canvas.marks import log_labels
from ..canvas.matrix import log_matrix
from ..canvas.palette import CLEAR, FREE, PictureClass, shades, tint
from ..canvas.prose import described
from .map import SeaMap


# The width of a letter in the names of rows, in squares of the heat map.
_LETTER = 0.1
_PALE = 0.4


def log_exchange(map: SeaMap, exchange: Exchange) -> rrb.Container:
    """Log a tab that shows residence times in regions, and drifters that change regions."""
    names = exchange.name.tolist()
    colors = [tint(color, _PALE) for _, color in shades()]
    classes = [PictureClass("land", CLEAR), PictureClass("in no region", FREE)]
    classes += [PictureClass(name, colors[k % len(colors)]) for k, name in enumerate(names)]
    # If regions overlap, the last one is shown.
    kind = (exchange.inside * (np.arange(len(names))[:, None] + 1)).max(axis=0) + 1
    picture = map.picture("regions", classes, kind)
    stays = zip(names, exchange.inside, exchange.residence_hours, strict=True)
    labels = [(f"{name}: {_hours(time)}", *map.middle(here)) for name, here, time in stays]
    log_labels(map.stream, "map/region_names", labels, [FREE])
    longest = max(len(name) for name in names)
    elsewhere = exchange.after @ ~exchange.inside.any(axis=0)
    ends = 100 * np.column_stack([exchange.share, elsewhere, exchange.left])
    columns, margin = [*names, "elsewhere", "off the map"], 0.4 + _LETTER * longest
    title = f"Of 100 drifters from a row, after {_hours(exchange.after_hours)}"
    matrix = "exchange/matrix", title, ends, names, columns
    shares, legend = log_matrix(map.stream, *matrix, "%", margin)
    seen = "Regions, and how long drifters stay in them"
    views = [map.view(seen, [picture, "region_names"]), shares]
    text = f"""# From region to region

Drifters are released uniformly in each region of the surface. **Left**: the regions, with the mean
time until a drifter first leaves its region. **Right**: the share of the drifters of each row that
are in each column after **{_hours(exchange.after_hours)}**, in percent.

{described(exchange, "name", "cell_count", "residence_hours", "left")}
"""
    return map.tab("exchange", "Regions", views, text, legend)


def _hours(hours: float) -> str:
    return in_time(hours) if np.isfinite(hours) else "forever"
