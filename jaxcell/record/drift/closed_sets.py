from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ...base.formatting import in_time
from ...drift import ClosedSets
from ..canvas.marks import log_labels
from ..canvas.palette import CLEAR, FREE, PictureClass
from ..canvas.prose import described
from .groups import HOMES, home_color
from .map import SeaMap


_NONE = PictureClass("in no nearly closed set", FREE)


def log_closed_sets(maps: Sequence[SeaMap], sets: ClosedSets) -> rrb.Container:
    """Log a tab that shows nearly closed sets of cells, which few drifters leave."""
    views = []
    # Numbers continue from layer to layer, while ranks begin again in each layer.
    firsts = np.cumsum([0, *(layer.count for layer in sets.layers)]).tolist()
    ranks = sets.ranks
    for map, first, rank in zip(maps, firsts, ranks, strict=False):
        label = sets.labels[map.number]
        classes, labels = [PictureClass("land", CLEAR), _NONE], []
        for number, place in enumerate(rank.tolist(), first):
            name = f"set {place}: {sets.leakage[number]:.1%} leave"
            within = f"{name} in {in_time(sets.window_hours)}"
            classes.append(PictureClass(within, home_color(place)))
            labels.append((name, *map.middle(label == number)))
        kind = np.where(label < 0, 1, label - first + 2)
        picture = map.picture(f"nearly_closed_{map.number}", classes, kind)
        numbers = f"nearly_closed_numbers_{map.number}"
        log_labels(map.stream, f"map/{numbers}", labels, [one.color for one in classes[2:]])
        shown = [picture, numbers, f"drifters_{map.number}/here"]
        views.append(map.view(map.title, shown))
    most = max(int(rank.max(initial=-1)) + 1 for rank in ranks)
    legend = [*((f"set {rank}", home_color(rank)) for rank in range(min(most, len(HOMES)))), _NONE]
    columns = "rank", "depth", "size", "leakage", "lon", "lat"
    text = f"""# Parts that drifters hardly leave

These parts are *nearly closed*: if drifters are released uniformly in a part, less than half of
them are outside it after **{in_time(sets.window_hours)}**; the share is on the map. The parts come
from the leading eigenvectors of the Markov chain.

{described(sets, *columns)}
"""
    return maps[0].tab("nearly_closed", "Nearly closed sets", views, text, legend)
