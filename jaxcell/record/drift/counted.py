import numpy as np
import rerun as rr

from ...drift import CountedDrift
from ...drift.positions import on_the_grid
from ..canvas.marks import log_lines
from ..canvas.palette import Color
from ..canvas.prose import Spec, described, made_with
from ..canvas.stream import send_blueprint
from .distribution import density, levels
from .map import DRIFTER, SeaMap, log_maps


_BACK: Color = (200, 30, 30)


class CountedMap(SeaMap):
    """The map of cells of any shape, drawn on squares."""

    dry = "no drifter was there"
    drift: CountedDrift


def log_counted_drift(stream: rr.RecordingStream, found: CountedDrift, spec: Spec) -> None:
    """Record where drifters gather that are released evenly, and the routes between two places."""
    (map,) = log_maps(stream, found, CountedMap)
    times = np.rint(found.hours * 3600 / map.clock.seconds).astype(np.int64)
    kind = found.on_squares(np.stack([levels(share) for share in found.share]))
    views = [map.view("Density", [map.picture("density", density().classes, kind, times=times)])]
    legend = density().legend()
    ways = []
    for name, label, route, color in (
        ("there", "the most likely route", found.there, DRIFTER),
        ("back", "the route back", found.back, _BACK),
    ):
        if route is None:
            continue
        cells = route[0]
        place, _ = on_the_grid(map.water, found.counts.lon[cells], found.counts.lat[cells])
        # A route across the seam of the map is cut there.
        new = np.abs(np.diff(place[:, 0])) > map.water.number.shape[1] / 2
        parts = np.split(map.on_grid(*place.T), np.flatnonzero(new) + 1)
        log_lines(stream, f"map/{name}", [one for one in parts if len(one) > 1], color, 2.0)
        ways.append(name)
        legend.append((label, color))
    if ways:
        views.append(map.view("Most likely routes", ways))
    answer = "\n\n".join(found.answer)
    text = f"""# Where drifters gather

{answer}

The colours show the number of drifters in each cell, in multiples of the number at release: press
play.

{described(found, *(f"patch_{name}" for name in ("lon", "lat", "share", "density", "cells")))}

{made_with(spec)}"""
    tab = map.tab("patches", "Patches", views, text, legend)
    send_blueprint(stream, [tab], map.clock.timeline, map.clock.speed)
