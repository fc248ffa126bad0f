import rerun as rr

from ...drift import SeaDrift
from ..canvas.prose import Spec
from ..canvas.stream import send_blueprint
from .absorption import log_absorption
from .beaching import log_beaching
from .closed_sets import log_closed_sets
from .currents import log_currents
from .deployment import log_deployment
from .distances import log_distances
from .distribution import log_distribution
from .exchange import log_exchange
from .groups import groups_text, log_groups
from .map import CurrentMap, log_maps
from .reach import log_reach
from .voyage import log_voyage


def log_drift(stream: rr.RecordingStream, drift: SeaDrift, spec: Spec) -> None:
    """Record drifters in a sea, and the groups of cells in which they end, over dates."""
    seed = int(spec.get("seed", 0))
    maps = log_maps(stream, drift, CurrentMap)
    groups = log_groups(maps, groups_text(drift, spec))
    tabs = [groups, log_currents(maps, seed), log_distribution(maps), log_deployment(maps[0])]
    if any(drift.layers[map.number].transient_groups for map in maps):
        tabs.insert(3, log_absorption(maps))
    if drift.nearly_closed_sets is not None and drift.nearly_closed_sets.leakage.size:
        tabs.insert(1, log_closed_sets(maps, drift.nearly_closed_sets))
    if drift.distance_by_cell is not None:
        tabs.append(log_distances(maps))
    if drift.exchange is not None:
        tabs.append(log_exchange(maps[0], drift.exchange))
    if drift.beaching is not None:
        tabs.append(log_beaching(maps[0], drift.beaching))
    if drift.start is not None:
        tabs.append(log_reach(maps))
    if drift.voyage is not None:
        tabs.append(log_voyage(maps[0], seed))
    clock = maps[0].clock
    send_blueprint(stream, tabs, clock.timeline, clock.speed)
