"""Results as labelled datasets, and as recordings for the Rerun viewer.

**Datasets.** `dataset` converts any result of a study to an `xarray.Dataset`, from the descriptions
of its quantities. `save_dataset` writes a dataset as NetCDF-4. `summary` returns the single numbers
and tables as JSON. Datasets guarantee:

- Every dimension has a name, and every variable a `long_name` or `units`: metres, radians (also
    given in degrees), seconds, or steps.
- Attributes contain the provenance: the versions of jaxcell, of its source and of JAX, and the
    parameters as JSON in `spec`.
- A dataset is checked by its arrays alone: a contradiction raises `RuntimeError`, and the
    attributes `check_...` contain the values of the checks.
- Cells, vertices and groups are numbered from 0 as in the rest of the library; -1 means none.
    Rows of different lengths have an array of offsets: row `i` is
    `values[offset[i]:offset[i + 1]]`.
- One call makes an image of a map: `dataset.mixture.set_index(position=("y", "x")).unstack()`.

| result | dataset | recording |
| --- | --- | --- |
| of a study | `dataset` | `save_recording` |
| groups that do not fit in memory | `save_cells`, a Zarr store | |
| sweeps | `jaxcell.sweep.open_sweep` | `log_sweep` |
| robots while they drive | `jaxcell.robot.RunLog` | `RobotRecording` |

`save_deployment` also writes the cells in which to drop drifters as CSV or GeoJSON, for other
programs.

**Recordings.** `save_recording` and `log_sweep` write a file with a layout for the viewer, which
opens by `rerun FILE.rrd`. Timelines have names, such as `step` or `direction`, and a text explains
the views. Rerun, from the extra `view`, is imported at the first use.

**Notebooks.** `plot` draws one quantity of a result with matplotlib, from the extra `plot`. `show`
shows the recording of a result in the viewer, or a plot.

**Files** are written atomically: under a temporary name, and then renamed. The one exception is a
`RobotRecording`, which grows while the robots drive. If the run is interrupted, the recording has
all data except the last moments.

The examples need 64-bit numbers: set `JAX_ENABLE_X64=1`.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
