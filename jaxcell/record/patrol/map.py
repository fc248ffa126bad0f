import rerun as rr

from ...patrol import PatrolledMap
from ..canvas.map import CellMap
from ..canvas.prose import Spec
from ..canvas.stream import send_blueprint
from .attacks import log_attacks
from .capture import log_frontier, log_vulnerability
from .policies import log_covers, log_policies
from .regions import log_base, log_regions
from .target import log_target


def log_patrol_map(stream: rr.RecordingStream, patrol: PatrolledMap, spec: Spec) -> None:
    """Record robots that patrol a map, and an adversary, over the timelines `step` and `cover`."""
    map = CellMap(stream, patrol.cells)
    tabs = [
        log_attacks(map, patrol, spec),
        log_covers(map, patrol),
        log_policies(map, patrol),
        log_target(map, patrol),
        log_vulnerability(map, patrol),
    ]
    if patrol.frontier is not None:
        tabs.append(log_frontier(stream, patrol.frontier))
    if patrol.regions is not None:
        log_base(map, patrol.regions)
        tabs.insert(1, log_regions(map, patrol, patrol.regions))
    send_blueprint(stream, tabs, "step", 4.0)
