import numpy as np
import rerun as rr

from ...drift import Released
from ..canvas.palette import FREE
from ..canvas.prose import Spec, made_with
from ..canvas.scale import LEVELS, Scale
from ..canvas.stream import send_blueprint
from .map import SeaMap, log_maps


_NONE = "none or hardly any"
# Probabilities below this one have no colour.
_LEAST = 1e-4


def log_released(stream: rr.RecordingStream, found: Released, spec: Spec) -> None:
    """Record where the drifters of a release are, beside what the chain of cells gives."""
    (map,) = log_maps(stream, found, SeaMap)
    water, seconds = found.water, map.clock.seconds
    times = np.rint(found.hours * 3600 / seconds).astype(np.int64)
    bounds = np.geomspace(_LEAST, 1.0, LEVELS + 1)
    scale = Scale(100 * bounds, "{} %".format, {_NONE: FREE}, ground="land")
    views = []
    for name, title, values in (
        ("drifters", "Simulated drifters", found.share),
        ("chain", "The chain of cells", found.chain_share),
    ):
        share = values[:, water.row, water.column]
        kind = scale.levels(100 * share, {_NONE: share < _LEAST})
        views.append(map.view(title, [map.picture(name, scale.classes, kind, times=times)]))
    answer = "\n\n".join(found.answer)
    title = "Where drifters of one release are"
    if found.tried is not None:
        title = "Where drifters come from: time runs back from the find"
    text = f"""# {title}

{answer}

The colours show the probability that a drifter is in a cell: press play.

{made_with(spec)}"""
    tab = map.tab("release", "Release", views, text, scale.legend())
    send_blueprint(stream, [tab], map.clock.timeline, map.clock.speed)
