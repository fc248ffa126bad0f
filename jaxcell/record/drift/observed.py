import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from ...currents.sphere import EARTH_RADIUS
from ...drift import ObservedDrift
from ..canvas.marks import log_lines
from ..canvas.palette import CLEAR, Color
from ..canvas.prose import Spec, described, made_with
from ..canvas.scale import Scale
from ..canvas.stream import send_blueprint
from .absorption import log_absorption
from .closed_sets import log_closed_sets
from .distribution import density, levels, log_distribution
from .groups import GROUPS_SEEN, log_groups
from .map import DRIFTER, SeaMap, log_maps


# Limits that keep the file small and the cells visible.
_MAX_TRACKS, _MAX_PLACES = 40, 100_000


class ObservedMap(SeaMap):
    """The map of observed drifters."""

    dry = "too few were there"
    drift: ObservedDrift


def log_observed_drift(stream: rr.RecordingStream, found: ObservedDrift, spec: Spec) -> None:
    """Record observed drifters, and the groups of cells in which they end."""
    maps = log_maps(stream, found, ObservedMap)
    text = f"""# Where observed drifters end up

{GROUPS_SEEN}

{described(found.layers, "cells", "persistent_groups", "single_domicile_cells")}

## The map

{found.drifters:,} drifters of `{found.source}` made {found.moves:,} moves of
**{found.step / 86400:.3g} days** between {found.cells:,} cells of longitude and latitude. The
shares of the moves from each cell are a *Markov chain*; what ended in no cell has left the map.

{made_with(spec)}"""
    map, about = maps[0], f"The second map shows where they are {found.when}."
    kind = levels(_of_cells(map, found.distribution))
    then = map.view(found.when.capitalize(), [map.picture("distribution", density().classes, kind)])
    tabs = [log_groups(maps, text), log_distribution([map], [then], about)]
    tabs += [_log_errors(map), _log_observations(map)]
    if found.layers[0].transient_groups:
        tabs.insert(1, log_absorption(maps))
    if found.nearly_closed_sets is not None and found.nearly_closed_sets.leakage.size:
        tabs.insert(1, log_closed_sets(maps, found.nearly_closed_sets))
    send_blueprint(stream, tabs, map.clock.unit, map.clock.speed)


def _of_cells(map: ObservedMap, values: Float[np.ndarray, "1 rows columns"]) -> np.ndarray:
    return values[0, map.water.row, map.water.column]


def _log_errors(map: ObservedMap) -> rrb.Container:
    """Log a tab that shows sampling errors, which are estimated by resampling the drifters."""
    found = map.drift
    share = 100 * _of_cells(map, found.persistent_share)
    hours = _of_cells(map, found.absorption_time_error)
    more = map.water.cells * _of_cells(map, found.distribution_error)
    views: list[rrb.View] = []
    legend: list[tuple[str, Color]] = []
    for title, label, values, most in (
        ("In a persistent group", "{} % of draws".format, share, 100.0),
        ("Error of the time to the end", "{} h".format, hours, _most(hours)),
        ("Error of the number of drifters", "{} x".format, more, _most(more)),
    ):
        scale = Scale.over(values, label, least=0, most=most, open=values is not share)
        views.append(map.numbers(f"errors_{len(views)}", title, scale, values))
        legend += [(title, CLEAR), *scale.legend(3)]
    text = f"""# How sure is that?

As many drifters are drawn with replacement from those that were observed, again and again, each
with all of its moves. The *error* is the standard deviation of an answer over these draws.

{described(found, *(f"estimates_{name}" for name in ("name", "value", "error", "low", "high")))}
"""
    return map.tab("errors", "Errors", views, text, legend)


def _most(values: Float[np.ndarray, "cells"]) -> float:
    """Return the 95 % quantile of the finite values, as the upper end of a scale."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, 0.95)) if known.size else 1.0


def _log_observations(map: ObservedMap) -> rrb.Container:
    """Log the number of observed moves from each cell, and the tracks of some drifters."""
    found, water = map.drift, map.water
    count = found.counted.count.astype(float)
    scale = Scale.over(count, "{} moves".format, spaced=np.geomspace, ground="no cell")
    known = map.numbers("moves", f"{found.moves:,} moves, by where they begin", scale, count)
    seen, side = found.seen, np.degrees(water.dy[0, 0] / EARTH_RADIUS)
    column = (seen.lon - water.lon[0, 0] + side / 2) % 360 / side - 0.5
    place = map.on_grid(column, (seen.lat - water.lat[0, 0]) / side)
    every = max(1, seen.drifters // _MAX_TRACKS, seen.lon.size // _MAX_PLACES)
    shown = np.flatnonzero(seen.drifter % every == 0)
    # A track ends with the drifter, at the seam, and at the edge of the map.
    off = (place < 0).any(axis=1) | (place > map.size).any(axis=1)
    far = np.abs(np.diff(column, prepend=column[:1])) > water.number.shape[1] / 2
    new = (np.diff(seen.drifter, prepend=-1) != 0) | far | off
    ways = np.split(place[shown], np.flatnonzero(new[shown]))
    ways = [way for way in ways if len(way) > 1]
    log_lines(map.stream, "map/ways", ways, DRIFTER, 1.0)
    title = f"Tracks of {-(-seen.drifters // every)} of {seen.drifters:,} drifters"
    views = [known, map.view(title, ["ways"])]
    text = f"""# What was observed

**{found.drifters:,} drifters** of `{found.source}` were seen {found.observations:,} times. A *move*
takes {found.step / 86400:.3g} days, and ends where the same drifter was then. Where few begin,
answers are not sure.
"""
    legend = [*scale.legend(), ("the track of a drifter", DRIFTER)]
    return map.tab("observations", "Observations", views, text, legend)
