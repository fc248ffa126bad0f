import os
from collections.abc import Mapping
from typing import Any

import rerun.blueprint as rrb

from .blueprint import recording, send_blueprint
from .drift_currents import log_currents
from .drift_deployment import log_deployment, log_reach
from .drift_groups import log_absorption, log_groups
from .drift_voyage import log_voyage
from .sea_drift import SeaDrift
from .sea_map import SeaMap, log_sea_map


def log_drift(
    path: str | os.PathLike[str],
    drift: SeaDrift,
    *,
    seed: int = 0,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of what becomes of drifters in a sea.

    Over a timeline of hours, minutes or seconds from the first record: the current of each layer as
    arrows, drifters that it carries, and drifters that follow the policy to a goal. Without time:
    the persistent groups and what leads to them; how long that takes; where to drop drifters; what
    one may reach from the start; and in three dimensions the value function and the policy.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `drift`: what was found.
    - `seed`: of the drifters.
    - `spec`: what was asked for, shown in the text.

    The surface of the bundled sea at its first record; only recordings are written:

        >>> from jaxcell import drift, record
        >>> from jaxcell.bundled import bundled
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> water, flow = drift.Water.of(currents), drift.Flow.of(currents)
        >>> chain, duration = drift.drift_map(water, flow), drift.crossing_time(water, flow)
        >>> behaviour = drift.long_term_behaviour(chain, duration)
        >>> diagnosis = drift.diagnose(water, flow, behaviour.groups)
        >>> deployment, minimum = drift.deployment_cells(behaviour), drift.minimum_deployment(chain)
        >>> found = record.SeaDrift(currents, (behaviour,), (diagnosis,), deployment, minimum)
        >>> record.log_drift("drift.txt", found)
        Traceback (most recent call last):
            ...
        ValueError: drift.txt: expected the name of a recording, which ends in .rrd
    """
    sea = SeaMap(drift)
    with recording(path, "drift") as stream:
        log_sea_map(stream, sea)
        tabs = [
            log_groups(stream, sea, spec or {}),
            log_currents(stream, sea, seed),
            log_deployment(stream, sea),
        ]
        if any(drift.behaviours[layer].transient.count for layer in sea.layers):
            tabs.insert(2, log_absorption(stream, sea))
        if drift.start is not None:
            tabs.append(log_reach(stream, sea))
        if drift.voyage is not None:
            tabs.append(log_voyage(stream, sea, seed))
        send_blueprint(stream, rrb.Tabs(*tabs, active_tab=0), sea.clock.unit, sea.clock.speed)
