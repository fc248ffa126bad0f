"""Results to keep and to look at.

The `..._dataset` functions turn results into `xarray.Dataset`s with named dimensions, units and
provenance; `save_dataset` writes them as NetCDF. The `log_...` functions write Rerun recordings,
which open in the viewer with a layout of their own: `rerun FILE.rrd`. Rerun is imported when one of
these is first used.

Files appear whole or not at all.
"""

import importlib
from typing import TYPE_CHECKING, Any

from .coverage_dataset import coverage_dataset as coverage_dataset
from .dataset import (
    filter_dataset as filter_dataset,
    groups_dataset as groups_dataset,
    localization_dataset as localization_dataset,
    save_dataset as save_dataset,
)
from .deployment_files import (
    save_deployment_csv as save_deployment_csv,
    save_deployment_geojson as save_deployment_geojson,
)
from .drift_dataset import drift_dataset as drift_dataset
from .map_patrol import MapPatrol as MapPatrol
from .navigation_dataset import navigation_dataset as navigation_dataset
from .patrol_dataset import patrol_graph_dataset as patrol_graph_dataset
from .patrol_map_dataset import patrol_map_dataset as patrol_map_dataset
from .sea_drift import SeaDrift as SeaDrift
from .team_dataset import team_dataset as team_dataset


if TYPE_CHECKING:
    from .coverage import log_coverage as log_coverage
    from .drift import log_drift as log_drift
    from .groups import log_groups as log_groups
    from .localization import log_localization as log_localization
    from .navigation import log_navigation as log_navigation
    from .patrol_graph import log_patrol_graph as log_patrol_graph
    from .patrol_map import log_patrol_map as log_patrol_map
    from .robot import RecordedRobot as RecordedRobot, RobotRecording as RobotRecording
    from .sweep import log_sweep as log_sweep
    from .team import log_team as log_team


_LOGGED = (
    "coverage",
    "drift",
    "groups",
    "localization",
    "navigation",
    "patrol_graph",
    "patrol_map",
    "sweep",
    "team",
)


def __getattr__(name: str) -> Any:
    if name in ("RecordedRobot", "RobotRecording"):
        return getattr(importlib.import_module(f"{__name__}.robot"), name)
    family = name.removeprefix("log_")
    if name.startswith("log_") and family in _LOGGED:
        return getattr(importlib.import_module(f"{__name__}.{family}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
