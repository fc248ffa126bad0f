from collections.abc import Mapping
from typing import Any

import rerun as rr

from ...drift import SeaDrift
from ..canvas.stream import send_blueprint
from .absorption import log_absorption
from .closed_sets import log_closed_sets
from .currents import log_currents
from .deployment import log_deployment
from .groups import log_groups
from .map import log_maps
from .reach import log_reach
from .voyage import log_voyage


def log_drift(stream: rr.RecordingStream, drift: SeaDrift, spec: Mapping[str, Any]) -> None:
    """Log what becomes of drifters in a sea.

    Over a timeline of hours, minutes or seconds from the first record: the current of each layer as
    arrows, drifters that it carries, and drifters that follow the policy to a goal. Without time:
    the persistent groups and what leads to them; nearly closed sets; how long that takes; where to
    drop drifters; what one may reach from the start; and in three dimensions the value function and
    the policy. The drifters have the `seed` of `spec`.
    """
    seed = int(spec.get("seed", 0))
    maps = log_maps(stream, drift)
    tabs = [log_groups(maps, spec), log_currents(maps, seed), log_deployment(maps[0])]
    if any(drift.layers[map.number].transient_groups for map in maps):
        tabs.insert(2, log_absorption(maps))
    if drift.nearly_closed_sets is not None:
        tabs.insert(1, log_closed_sets(maps, drift.nearly_closed_sets))
    if drift.start is not None:
        tabs.append(log_reach(maps))
    if drift.voyage is not None:
        tabs.append(log_voyage(maps[0], seed))
    clock = maps[0].clock
    send_blueprint(stream, tabs, clock.unit, clock.speed)
