import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...dynamics import MorseSets
from ..canvas.map import log_pictures
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES, MARGIN, PictureClass
from ..canvas.prose import Spec, described, made_with, numbers
from ..canvas.stream import send_blueprint
from .box import category, log_axes, scaled, view


# Number of sets with names in the picture.
_MAX_NAMED = 254
_SEEN = """Boxes of one colour are a set of boxes that all lead to each other. Each set leads to the
sets that follow it in the order."""


def log_morse_sets(stream: rr.RecordingStream, sets: MorseSets, spec: Spec) -> None:
    """Record Morse sets, projected onto the first two and the first three axes."""
    box = sets.box
    columns, rows = (*box.cells[:2], 1)[:2]
    seen = sets.drawn.reshape(columns, rows, -1).max(axis=-1)
    picture = np.minimum(seen + 1, _MAX_NAMED + 1).astype(np.uint8).T
    named = [PictureClass(f"set {k}", category(k)) for k in range(min(sets.sets, _MAX_NAMED))]
    log_pictures(stream, "box/sets", [PictureClass("no set", MARGIN), *named], picture)
    log_axes(stream, box, sets.names, ("sets",))
    views: list[rrb.View] = [view("Morse sets", "sets")]
    if box.dimensions > 2:
        place = scaled(box, (sets.lower + sets.upper) / 2)
        colors = [category(k) for k in sets.member]
        stream.log("space/sets", rr.Points3D(place[:, :3], colors=colors, radii=0.04), static=True)
        views.append(rrb.Spatial3DView(origin="space", name="First three axes"))
    table = described(sets, "boxes", "share", "leads_to", first={"": range(sets.sets)})
    parts = [f"# {sets.title}", _SEEN, *sets.remarks, table, numbers(sets), made_with(spec)]
    legend = [(f"set {k}", category(k)) for k in range(min(sets.sets, len(CATEGORIES)))]
    tab = log_tab(stream, "", sets.title, views, "\n\n".join(parts), [*legend, ("no set", MARGIN)])
    send_blueprint(stream, [tab], "slice", 10.0)
