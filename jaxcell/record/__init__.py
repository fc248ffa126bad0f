"""Results to keep and to look at: labelled datasets, and recordings for the Rerun viewer.

**Datasets.** `dataset` turns any result of a study into an `xarray.Dataset`, from what the result
says of its quantities, and `save_dataset` writes it as NetCDF-4. `summary` gives the numbers that
people and scripts want. What datasets guarantee:

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
| any result of a study | `dataset` | `save_recording` |
| groups of more cells than fit the memory | `save_cells`, a Zarr store | |
| sweeps | `jaxcell.sweep.open_sweep` | `log_sweep` |
| robots while they drive | `jaxcell.robot.RunLog` | `RobotRecording` |

Cells to drop drifters in are also written for other programs, as CSV or GeoJSON, by
`save_deployment`.

**Recordings.** `save_recording` and `log_sweep` write a file that opens in the viewer with a layout
of its own: `rerun FILE.rrd`. Time is a timeline with a name, such as `step` or `direction`; a text
says what one sees. Rerun, of the extra `view`, is imported when one of them is first used.

**Files** appear whole or not at all: they are written under another name and renamed. The one
exception is a `RobotRecording`, which grows while the robots drive, so that whatever ends the run
leaves all but its last moments.

The examples need 64-bit numbers: set `JAX_ENABLE_X64=1`.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
