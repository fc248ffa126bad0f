import dataclasses
import hashlib
import shutil
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...base import memory
from ...base.indices import check_whole
from ...base.shown import Shown
from ...space.box import Box
from ..arrival import mean_arrivals
from ..attractors import attractors
from ..basin import Basins, by_cells
from ..batches import CHUNK
from ..imaging import Say, changed_by_half_step, check_map, images_of_each, torn_axes
from ..maps import Flow, Map
from .folder import Folder
from .passes import groups_in_passes


# Number of cells after which the record is written.
PART = 64 * CHUNK
# Bytes per cell in files (image, group, step and basin; level, several and left) and in memory.
_FILES = 4 * 4.0 + 3
_MEMORY = 1
_FIXED = memory.LIBRARIES + 400e6
# Seconds per cell of all passes, measured for Thomas' system on a processor of 2 cores.
_PASSES = 4e-7


@dataclasses.dataclass(frozen=True)
class Foretold(Shown):
    """The estimated time, memory and disk space that `stored_basins` needs."""

    cells: int
    seconds: float
    "Time to map all cells, extrapolated from some of them, and to find their groups."
    memory: float
    "Peak memory in bytes if the map is dissipative; a map that preserves volumes needs more."
    disk: float
    "Size of the files in bytes."

    def __str__(self) -> str:
        minutes = max(1, round(self.seconds / 60))
        return (
            f"{self.cells:,} cells take about {minutes:,} min, {memory.gigabytes(self.memory)} of "
            f"memory and {memory.gigabytes(self.disk)} of files"
        )


def foretold(map: Map, box: Box, params: Any = None, *, follow: int = 0) -> Foretold:
    """Estimate what [`jaxcell.dynamics.stored_basins`][] needs, by mapping some of the cells.

    **Arguments:** as for [`jaxcell.dynamics.images`][]. **Returns:** the time in seconds, and the
    memory and disk space in bytes.

    Henon's map:

        >>> from jaxcell import dynamics, space
        >>> from jaxcell.dynamics import systems
        >>> box = space.Box([-2, -2], [2, 2], cells=[20_000, 20_000])
        >>> dynamics.foretold(systems.henon.map, box, systems.henon.params).disk / box.size
        19.0
    """
    follow = check_whole("follow", follow)
    check_map(map, box, params)
    # The chunk in the middle; the first call compiles.
    first = max(0, box.size // 2 - CHUNK)
    within = slice(first, min(first + 2 * CHUNK, box.size))
    image = np.empty((1, box.size), np.int32)
    for _ in range(2):
        begun = time.perf_counter()
        images_of_each(map, box, [params], follow=follow, out=image, within=within)
        each = (time.perf_counter() - begun) / (within.stop - within.start)
    return Foretold(
        box.size,
        seconds=box.size * (each + _PASSES),
        memory=_FIXED + _MEMORY * box.size,
        disk=_FILES * box.size,
    )


def stored_basins(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    folder: str | Path,
    follow: int = 0,
    seed: int = 0,
    labels: tuple[str, ...] = (),
    say: Say | None = None,
) -> Basins:
    """Compute [`jaxcell.dynamics.basins`][] in files, for more cells than fit into memory.

    Images are written to a file, and groups are found by passes over it, which drop the cells
    without preimages. One byte of memory is needed per cell, and 16 more per cell that remains: few
    cells if the map is dissipative, and all cells if it preserves volumes. Where groups are not
    exactly the attractors, 4 bytes per cell are needed at the end, to measure times to them. To
    continue an interrupted computation, repeat the call.

    **Arguments:** as for [`jaxcell.dynamics.basins`][], and a folder for the files.

    **Returns:** basins whose arrays stay in the files, and whose `time` is always `None`.
    `numpy.load("basin.npy", mmap_mode="r")` opens an array of the folder.

    A box of few cells:

        >>> from jaxcell import dynamics, examples, space
        >>> box = space.Box([0], [1], cells=[20])
        >>> basins = dynamics.stored_basins(lambda x, p: x / 2, box, folder=examples.folder())
        >>> basins.fraction.tolist()
        [1.0]
    """
    follow, seed = check_whole("follow", follow), check_whole("seed", seed)
    check_map(map, box, params)
    files = Folder(folder, _digest(map, box, params, follow))
    _check_disk(files, box)
    (torn,) = torn_axes(map, box, [params], labels)
    image = files.array("image", np.int32, box.size + 2)
    cells = image[:-2]
    for part in files.parts("images", box.size, PART):
        images_of_each(map, box, [params], follow=follow, out=cells[None], within=part, say=say)
    image[-2:] = box.outside, box.nowhere
    groups = groups_in_passes(image, files, say)
    if say is not None:
        say("finding attractors", 0, 0)
    (ends,) = attractors(map, box, [params], [groups], follow=follow, seed=seed)
    (changed,) = changed_by_half_step(map, box, [params], cells[None], follow=follow)
    basins = by_cells(box, params, cells, groups, ends, changed, new=files.array)
    duration = getattr(map, "duration", None)
    about: dict[str, Any] = {"torn": torn, "duration": duration, "labels": labels}
    basins = dataclasses.replace(basins, follow=follow, map=map, **about)
    return dataclasses.replace(basins, **mean_arrivals(map, basins))


def _check_disk(files: Folder, box: Box) -> None:
    written = sum(file.stat().st_blocks * 512 for file in files.path.iterdir())
    needed, free = _FILES * box.size - written, shutil.disk_usage(files.path).free
    if needed > free:
        raise ValueError(
            f"folder: {files.path} needs {memory.gigabytes(needed)} more of disk, and "
            f"{memory.gigabytes(free)} are free; give a folder on another disk, or fewer cells"
        )


def _digest(map: Map, box: Box, params: Any, follow: int) -> str:
    """Compute a digest of a map (its operations and constants), a box and options."""
    middle = jax.ShapeDtypeStruct((box.dimensions,), jnp.zeros(()).dtype)
    traced = jax.make_jaxpr(map)(middle, params)
    known = hashlib.sha256(str(traced).encode())
    known.update(repr((box, follow)).encode())
    crossing = (map.dt, map.steps, map.crossing) if isinstance(map, Flow) else ()
    for leaf in (*traced.consts, *jax.tree.leaves(params), *crossing):
        known.update(np.asarray(leaf).tobytes())
    return known.hexdigest()
