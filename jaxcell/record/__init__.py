"""Results to keep and to look at: labelled datasets, and recordings for the Rerun viewer.

**Datasets.** The `..._dataset` functions turn results into `xarray.Dataset`s, and `save_dataset`
writes these as NetCDF-4. What they guarantee:

- Every dimension has a name, and every variable a `long_name` or `units`: metres, radians (degrees
    beside them where people read them), seconds, or steps.
- The attributes say where the numbers are from: the versions of jaxcell, of its source, and of JAX,
    and as `spec`, as JSON, what was asked for.
- A dataset is checked as it is made, independently of what made it: a contradiction raises
    `RuntimeError`, and the attributes `check_...` count what was found.
- Cells, vertices and groups are numbered from 0 as in the rest of the library; -1 stands for none.
    Where rows have different lengths, an index of offsets goes with them: row `i` is
    `values[offset[i]:offset[i + 1]]`.
- A picture of a map is one call away: `dataset.mixture.set_index(position=("y", "x")).unstack()`.

| of | dataset | recording |
| --- | --- | --- |
| periodic groups | `groups_dataset` | `log_groups` |
| filters | `filter_dataset` | |
| runs of filters | `localization_dataset` | `log_localization` |
| plans | `navigation_dataset` | `log_navigation` |
| teams | `team_dataset` | `log_team` |
| patrols on a graph | `patrol_graph_dataset` | `log_patrol_graph` |
| patrols on a map, coverage, and any other result of a study | `dataset` | `save_recording` |
| drifters, `SeaDrift` | `drift_dataset` | `log_drift` |
| sweeps | `jaxcell.sweep.open_sweep` | `log_sweep` |
| robots while they drive | `jaxcell.robot.RunLog` | `RobotRecording` |

Cells to drop drifters in are also written for other programs, as CSV by `save_deployment_csv` and
as GeoJSON by `save_deployment_geojson`.

**Recordings.** The `log_...` functions write a file that opens in the viewer with a layout of its
own: `rerun FILE.rrd`. Time is a timeline with a name, such as `step` or `direction`; a text says
what one sees. Rerun is imported when one of these is first used.

**Files** appear whole or not at all: they are written under another name and renamed. The one
exception is a `RobotRecording`, which grows while the robots drive, so that whatever ends the run
leaves all but its last moments.

The examples need 64-bit numbers: set `JAX_ENABLE_X64=1`.
"""

import importlib
from typing import TYPE_CHECKING, Any

from .bounce_datasets import (
    filter_dataset as filter_dataset,
    groups_dataset as groups_dataset,
    localization_dataset as localization_dataset,
)
from .data.described import dataset as dataset, summary as summary
from .data.files import save_dataset as save_dataset
from .deployment_files import (
    save_deployment_csv as save_deployment_csv,
    save_deployment_geojson as save_deployment_geojson,
)
from .drift_dataset import drift_dataset as drift_dataset
from .navigation_dataset import navigation_dataset as navigation_dataset
from .patrol_dataset import patrol_graph_dataset as patrol_graph_dataset
from .recordings import save_recording as save_recording
from .sea_drift import SeaDrift as SeaDrift
from .team_dataset import team_dataset as team_dataset


if TYPE_CHECKING:
    from .drift import log_drift as log_drift
    from .groups import log_groups as log_groups
    from .localization import log_localization as log_localization
    from .navigation import log_navigation as log_navigation
    from .patrol_graph import log_patrol_graph as log_patrol_graph
    from .robot import RobotRecording as RobotRecording
    from .robot_track import RecordedRobot as RecordedRobot
    from .sweep import log_sweep as log_sweep
    from .team import log_team as log_team


_LOGGED = (
    "drift",
    "groups",
    "localization",
    "navigation",
    "patrol_graph",
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
