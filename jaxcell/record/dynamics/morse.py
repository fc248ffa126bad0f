import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...dynamics import MorseSets
from ..canvas.map import log_pictures
from ..canvas.marks import log_labels
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES, MARGIN, PLAIN, Color, PictureClass
from ..canvas.prose import Spec, described, made_with, numbers
from ..canvas.stream import plane, send_blueprint


# Sides of the drawn box, whatever the units of its axes.
_SIDE = 10.0
_AROUND = -3, -1.2, _SIDE + 1, _SIDE + 1.4
# Sets that have names in the picture.
_MAX_NAMED = 254
_SEEN = """Boxes of one colour are a set of boxes that all lead to each other. Each set leads to the
sets that follow it in the order."""


def log_morse_sets(stream: rr.RecordingStream, sets: MorseSets, spec: Spec) -> None:
    """Log Morse sets, seen along the axes after the second, and in the first three axes."""
    box = sets.box
    columns, rows = (*box.cells[:2], 1)[:2]
    seen = sets.drawn.reshape(columns, rows, -1).max(axis=-1)
    picture = np.minimum(seen + 1, _MAX_NAMED + 1).astype(np.uint8).T
    named = [PictureClass(f"set {k}", _color(k)) for k in range(min(sets.sets, _MAX_NAMED))]
    log_pictures(stream, "box/sets", [PictureClass("no set", MARGIN), *named], picture)
    stretch = rr.Transform3D(translation=[0, _SIDE, 0], scale=[_SIDE / columns, -_SIDE / rows, 1])
    stream.log("box/sets", stretch, static=True)
    below = _SIDE + 0.2
    ends = [(f"{box.lower[0]:.4g}", 0.0, below), (sets.names[0], _SIDE / 2, below)]
    ends.append((f"{box.upper[0]:.4g}", _SIDE, below))
    if box.dimensions > 1:
        ends += [(f"{box.upper[1]:.4g}", -0.7, 0.0), (sets.names[1], -1.4, _SIDE / 2)]
        ends.append((f"{box.lower[1]:.4g}", -0.7, _SIDE - 0.4))
    log_labels(stream, "box/ends", ends)
    views: list[rrb.View] = [plane("box", "Morse sets", _AROUND, ["/box/sets", "/box/ends"])]
    if box.dimensions > 2:
        size = np.array(box.upper) - np.array(box.lower)
        place = ((sets.lower + sets.upper) / 2 - np.array(box.lower)) / size * _SIDE
        colors = [_color(k) for k in sets.member]
        stream.log("space/sets", rr.Points3D(place[:, :3], colors=colors, radii=0.04), static=True)
        views.append(rrb.Spatial3DView(origin="space", name="First three axes"))
    table = described(sets, "boxes", "share", "leads_to", first={"": range(sets.sets)})
    parts = [f"# {sets.title}", _SEEN, *sets.remarks, table, numbers(sets), made_with(spec)]
    legend = [(f"set {k}", _color(k)) for k in range(min(sets.sets, len(CATEGORIES)))]
    tab = log_tab(stream, "", sets.title, views, "\n\n".join(parts), [*legend, ("no set", MARGIN)])
    send_blueprint(stream, [tab], "slice", 10.0)


def _color(number: int) -> Color:
    return list(CATEGORIES.values())[number] if number < len(CATEGORIES) else PLAIN
