import rerun as rr

from ...patrol import PatrolledMap
from ..canvas.map import CellMap
from ..canvas.prose import Spec
from ..canvas.stream import send_blueprint
from .attacks import log_attacks
from .cover import log_covers
from .frontier import log_frontier
from .policies import log_policies
from .regions import log_base, log_regions
from .target import log_target
from .vulnerability import log_vulnerability


def log_patrol_map(stream: rr.RecordingStream, patrol: PatrolledMap, spec: Spec) -> None:
    """Record robots that patrol a map with limited visibility.

    The timeline `step` shows the robots and the cells in view, and an adversary that repeatedly
    attacks one cell. The cells of each cover appear one by one on the timeline `cover`, and more
    slowly on `step`. Static views show the share of steps of each robot along each edge, the base
    station and the regions around it, the simulated, exact and fitted distributions of the time
    until a robot sees the attacked cell, the probability of capture at each cell, and the trade-off
    between capture and unpredictability, if it was computed.
    """
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
