"""Results as labelled datasets, and as recordings for the Rerun viewer.

**Datasets.** `dataset` converts any result of a study to an `xarray.Dataset`, labelled with the
descriptions of its quantities. `save_dataset` writes a dataset as NetCDF-4. `summary` returns the
single numbers and tables as JSON. Datasets guarantee:

- Every dimension has a name, and every variable a `long_name` or `units`. Examples of units are
    metres, seconds, steps, and radians (also given in degrees).
- Attributes contain the provenance: the versions of jaxcell, of its source and of JAX, and the
    parameters as JSON in `spec`.
- The arrays of a dataset agree with each other. Otherwise `dataset` raises `RuntimeError`. The
    attributes `check_...` contain the values of these checks.
- Cells, vertices and groups are numbered from 0 as in the rest of the library; -1 means none.
- Rows of different lengths, such as the cells of each state of a filter, have an array of offsets:
    row `i` is `member[offset[i]:offset[i + 1]]`.
- `dataset.mixture.set_index(position=("y", "x")).unstack()` converts an array over positions, here
    `mixture`, to an image of the map.

| result | dataset | recording |
| --- | --- | --- |
| results of studies | `dataset` | `save_recording` |
| groups that do not fit in memory | `save_cells`, a Zarr store | |
| sweeps | `jaxcell.sweep.open_sweep` | `log_sweep` |
| robots while they drive | `jaxcell.robot.RunLog` | `RobotRecording` |

`save_deployment` also writes the cells in which to drop drifters as CSV or GeoJSON, for other
programs, and `save_release` the areas that hold half and nine tenths of the drifters of a release.
`save_sea` writes a picture of a release or of a deployment.

**Recordings.** `save_recording` and `log_sweep` write a file for the viewer, which `rerun FILE.rrd`
opens. The file has timelines such as `step` or `direction`, and a text that explains the views.
Recordings need Rerun, which the extra `view` installs.

**Notebooks.** `show` shows the recording of a result in the viewer. `plot` draws one quantity of a
result with matplotlib, which the extra `plot` installs. `save_rounds` writes a picture of the
rounds of guards.

**Files** are written atomically: under a temporary name, and then renamed. The one exception is a
`RobotRecording`, which grows while the robots drive. If the run is interrupted, the recording has
all data except the last moments.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
