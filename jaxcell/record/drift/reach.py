from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from ..canvas.marks import log_dots
from ..canvas.palette import BELIEF, CATEGORIES, CLEAR, FREE, START, PictureClass, tint
from ..canvas.prose import described
from .frame import place_name
from .map import CurrentMap


_CLASSES = [
    PictureClass("land", CLEAR),
    PictureClass("out of reach", FREE),
    PictureClass("if it goes up and down on its way", tint(CATEGORIES["yellow"], 0.45)),
    PictureClass("if it stays at the depth to which it dived at first", tint(BELIEF, 0.6)),
]


def log_reach(maps: Sequence[CurrentMap]) -> rrb.Container:
    """Log a tab that shows, in each layer, the cells that can ever be reached from the start."""
    drift, first = maps[0].drift, maps[0]
    assert drift.reachable is not None
    assert drift.start is not None
    place = first.xy(np.array([drift.start]))
    log_dots(first.stream, "map/start", place, 1.3 * first.mark, START)
    views = []
    for map in maps:
        stays, moves = (drift.of_layer(cells, map.number) for cells in drift.reachable)
        kind = np.where(stays, 3, 1 + moves)
        picture = map.picture(f"reach_{map.number}", _CLASSES, kind)
        title = f"{map.title}: {int(stays.sum()):,} of {stays.size:,} cells"
        views.append(map.view(title, [picture, "start"]))
    text = f"""# What can ever be reached

A cell is in reach if drifters from the start visit it with any positive probability, after any
time.

A drifter is dropped at **{place_name(*drift.place(drift.start)[:2])}** (the dark blue dot).

- **Pale blue**: it dives to a depth at once, and stays there.
- **Yellow**: it only gets there if it also goes up and down later.

{described(drift, "depth", "reached_cells", "reached_cells_at_any_depth")}
"""
    return first.tab("reach", "Reach", views, text, [("the start", START), *_CLASSES[:0:-1]])
