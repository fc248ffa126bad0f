"""Periodic groups of a map in a file, found in passes that each read the whole file.

A cell without preimages is transient. A pass marks the images of the remaining cells, and drops the
cells without a mark. The level of a cell is the number of the pass that dropped it. If the map is
dissipative, few cells remain, whose groups are found in memory. Passes in the reverse order, from
the last level to the first, then give each dropped cell the group of its image, and one step more
than its image. A pass may be repeated, so a killed computation continues with its unfinished pass.
"""

import jax
import numpy as np
from jaxtyping import Int, UInt8

from ...base import memory
from ...mapping import PeriodicGroups
from ...mapping.walk import walked_leaders
from ..batches import slices
from ..imaging import Say
from .folder import Folder


# Share of the cells that a pass must drop to pay, and number of cells that are walked in memory
# even if another pass would drop them.
_WORTH = 0.2
FEW = 1 << 24
_MAX_LEVELS = 250
# Bytes per walked cell: its image, its group and its step.
_BYTES_PER_WALKED = 16


def groups_in_passes(
    image: Int[np.ndarray, "cells"], folder: Folder, say: Say | None = None
) -> PeriodicGroups:
    """Compute [`periodic_groups`][jaxcell.mapping.periodic_groups] with arrays in files."""
    size = image.size
    level = folder.array("level", np.uint8, size)
    group, step = (folder.array(name, np.int32, size) for name in ("group", "step"))
    if "levels" not in folder.done:
        _drop(image, level, folder, say)
    levels = folder.done["levels"]
    if "walked" not in folder.done:
        if say is not None:
            say("finding groups of the remaining cells", 0, 0)
        np.save(folder.path / "group_period.npy", _walk(image, level, group, step))
        folder.finish("walked", 1)
    for k in range(folder.done.get("back", levels), 0, -1):
        for part in slices(size):
            cells = part.start + np.flatnonzero(level[part] == k)
            to = image[cells]
            group[cells], step[cells] = group[to], step[to] + 1
        folder.finish("back", k - 1)
        if say is not None:
            say("passes back over the dropped cells", levels - k + 1, levels)
    period = np.load(folder.path / "group_period.npy")
    return PeriodicGroups(group, step, period, np.asarray(period.size))


def _drop(
    image: Int[np.ndarray, "cells"],
    level: UInt8[np.ndarray, "cells"],
    folder: Folder,
    say: Say | None,
) -> None:
    """Write into `level` the pass that drops each cell, or 0 if it remains after all passes."""
    reached = np.zeros(image.size, bool)
    left = folder.done.get("left", image.size)
    for k in range(folder.done.get("level", 0) + 1, _MAX_LEVELS):
        reached[:] = False
        for part in slices(image.size):
            # Cells of this level were dropped when the pass was interrupted.
            reached[image[part][(level[part] == 0) | (level[part] == k)]] = True
        before, left = left, 0
        for part in slices(image.size):
            own = level[part]
            alive = (own == 0) | (own == k)
            level[part] = np.where(alive, np.where(reached[part], 0, k), own)
            left += int(np.count_nonzero(alive & reached[part]))
        folder.done["left"] = left
        folder.finish("level", k)
        if say is not None:
            say(f"pass {k}: {left / image.size:.2%} of the cells remain", 0, 0)
        dropped = 1 - left / before
        if left <= FEW or dropped < _WORTH / 10 or (dropped < _WORTH and left <= 16 * FEW):
            break
    folder.finish("levels", folder.done["level"])


def _walk(
    image: Int[np.ndarray, "cells"],
    level: UInt8[np.ndarray, "cells"],
    group: Int[np.ndarray, "cells"],
    step: Int[np.ndarray, "cells"],
) -> Int[np.ndarray, "groups"]:
    """Write the groups and steps of the cells of level 0, and return the periods of the groups."""
    parts = [part.start + np.flatnonzero(level[part] == 0) for part in slices(image.size)]
    left = np.concatenate(parts, dtype=np.int32)
    del parts
    memory.check(
        _BYTES_PER_WALKED * left.size,
        f"a map of which {left.size:,} cells remain",
        "take fewer cells",
    )
    rest = np.empty_like(left)
    for part in slices(left.size):
        rest[part] = np.searchsorted(left, image[left[part]])
    # An accelerator is slow at a loop over cells.
    with jax.default_device(jax.devices("cpu")[0]):
        leader, steps = (np.asarray(x) for x in walked_leaders(rest))
    del rest
    leaders = np.concatenate(
        [
            part.start + np.flatnonzero(leader[part] == np.arange(part.start, part.stop))
            for part in slices(left.size)
        ]
    )
    period = np.zeros(leaders.size, np.int32)
    for part in slices(left.size):
        number = np.searchsorted(leaders, leader[part])
        group[left[part]], step[left[part]] = number, steps[part]
        np.add.at(period, number[steps[part] == 0], np.int32(1))
    return period
