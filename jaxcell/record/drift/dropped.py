import numpy as np
import rerun as rr

from ...drift import Dropped
from ..canvas.marks import log_dots, log_lines
from ..canvas.palette import BLACK, FREE, GOAL, ROBOT
from ..canvas.prose import Spec, described, made_with
from ..canvas.scale import Scale
from ..canvas.stream import send_blueprint
from .map import SeaMap, log_maps


_NEVER = "not visited"
_MAX_ROWS = 48


def log_dropped(stream: rr.RecordingStream, found: Dropped, spec: Spec) -> None:
    """Record where to drop drifters, their tracks and ends, and the cells that they visit."""
    (map,) = log_maps(stream, found, SeaMap)
    water, tracks = found.water, found.tracks
    visit = found.visit[water.row, water.column]
    scale = Scale(np.linspace(0, 100, 33), "{} %".format, {_NEVER: FREE}, ground="land")
    kind = scale.levels(100 * visit, {_NEVER: visit == 0})
    begin, ends = map.xy(found.cell), map.on_grid(tracks.x, tracks.y)
    log_lines(stream, "map/tracks", [*np.concatenate([begin[None], ends]).swapaxes(0, 1)], BLACK)
    log_dots(stream, "map/drops", begin, map.mark, ROBOT)
    log_dots(stream, "map/ends", ends[-1], map.mark, GOAL)
    views = [
        map.view("Visits", [map.picture("visit", scale.classes, kind), "tracks", "drops", "ends"])
    ]
    answer = "\n\n".join(found.answer)
    columns = [f"drop_{name}" for name in ("lon", "lat")]
    columns += ["gained", "stranded", "left", "end_lon", "end_lat", "end_spread"]
    text = f"""# Where to drop drifters

{answer}

The colours show the probability that a drifter visits a cell.

{described(found, *columns, first={"number": range(1, found.cell.size + 1)}, most=_MAX_ROWS)}

{made_with(spec)}"""
    legend = [("drop a drifter here", ROBOT), ("its end", GOAL), *scale.legend()]
    tab = map.tab("deploy", "Where to drop drifters", views, text, legend)
    send_blueprint(stream, [tab], map.clock.timeline, map.clock.speed)
