import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...dynamics import Escape
from ..canvas.map import log_pictures
from ..canvas.page import log_legend, log_tab
from ..canvas.prose import Spec, described, made_with, numbers
from ..canvas.scale import Scale
from ..canvas.stream import send_blueprint
from .box import log_axes, view


_SEEN = """Colours are the mean time from each cell, on a logarithmic scale, and the probability of
the likeliest end. Further axes are cut in the middle."""


def log_escape(stream: rr.RecordingStream, escape: Escape, spec: Spec) -> None:
    """Record the mean time until a system leaves, and the probability of its likeliest end."""
    box, last = escape.box, int(escape.probability.argmax())
    inside = escape.time > 0
    time = np.where(inside, escape.time, np.nan)
    likely = Scale.over(escape.committor[last], least=0.0, most=1.0, ground="end")
    pictures = {
        "time": (Scale.over(time, spaced=np.geomspace, ground="end"), time, "Mean time"),
        "committor": (likely, escape.committor[last], f"Probability of {escape.end[last]}"),
    }
    middle = [n // 2 for n in box.cells[2:]]
    cut = np.ravel_multi_index(middle, box.cells[2:]) if middle else 0
    columns, rows = (*box.cells[:2], 1)[:2]
    views: list[rrb.Container] = []
    for name, (scale, values, title) in pictures.items():
        levels = np.where(inside, scale.levels(np.nan_to_num(values)), 0).astype(np.uint8)
        plane = levels.reshape(columns, rows, -1)[..., cut]
        log_pictures(stream, f"box/{name}", scale.classes, plane.T)
        key = log_legend(stream, f"{name}/legend", scale.legend())
        views.append(rrb.Vertical(view(title, name), key, row_shares=[4, 1]))
    log_axes(stream, box, escape.names, tuple(pictures))
    tables = [described(escape, "within", "within_error", first={"share": escape.share.tolist()})]
    tables.append(described(escape, "probability", "probability_error", first={"end": escape.end}))
    answer = "\n\n".join(escape.answer)
    parts = [f"# {escape.title}", answer, _SEEN, *tables, numbers(escape), made_with(spec)]
    tab = log_tab(stream, "", escape.title, rrb.Horizontal(*views), "\n\n".join(parts), [])
    send_blueprint(stream, [tab], "slice", 10.0)
