import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph

from .. import bounce as bouncing
from ..bounce import BounceGroups
from ..mapping import SimpleMap
from ..space import CELL_BY_CELL, CellSpace, Motion
from .comparison import Comparison, sample


_IMAGES = 200
# A step is a clear case if it avoids or crosses walls by more than this distance, in cells.
_NEAR = 1e-7


def compare_images(
    cells: CellSpace,
    simple_map: SimpleMap,
    bounce: float,
    *,
    only: Int[np.ndarray, "cells"] | None = None,
    motion: Motion = CELL_BY_CELL,
) -> Comparison:
    """Compare the images of cells in `simple_map` with steps that shapely computes.

    `bounce` is the bouncing angle of `simple_map`, in radians. `only` are the cells to compare, by
    default a sample of 200 cells.
    """
    z = sample(cells.size, _IMAGES) if only is None else only
    target, clear = _targets(cells, z, motion)
    direction, position = np.divmod(z, cells.positions)
    bumps = target == position
    shift = round(bounce * cells.directions / (2 * np.pi))
    expected = (direction + shift * bumps) % cells.directions * cells.positions + target
    image, bumped = np.asarray(simple_map.image)[z], np.asarray(simple_map.bumped)[z]
    wrong = [
        f"cell {z[i]}: its image is {image[i]}, and {expected[i]} by geometry"
        for i in np.flatnonzero(clear & ((image != expected) | (bumped != bumps))).tolist()
    ]
    what = "images of cells, by shapely one step at a time"
    return Comparison.exact(what, wrong, int(clear.sum()))


def _targets(
    cells: CellSpace, z: Int[np.ndarray, "cells"], motion: Motion
) -> tuple[Int[np.ndarray, "cells"], Bool[np.ndarray, "cells"]]:
    """Find the position after a step from each cell; a robot that bumps keeps its position.

    **Returns:** the positions, and a mask of the cells to compare. A cell is left out if its step
    touches walls on both sides or ends in a corner, so rounding decides whether the robot bumps.
    """
    assert cells.workspace is not None
    near, space = _NEAR * cells.cell, cells.workspace.free_space
    shrunk, grown = (space.buffer(by, join_style="mitre") for by in (-near, near))
    shapely.prepare(shrunk)
    shapely.prepare(grown)
    x, y, theta = cells.centre(z)
    start, ahead = np.stack([x, y], axis=1), np.stack([np.cos(theta), np.sin(theta)], axis=1)
    end = start + (motion.step or cells.cell) * ahead
    square = np.floor(np.round((end - cells.origin) / cells.cell, 9)).astype(int)
    limits = np.array(cells.free.shape[::-1])
    inside = ((square >= 0) & (square < limits)).all(axis=1)
    column, row = np.clip(square, 0, limits - 1).T
    inside &= cells.free[row, column]

    def parts(aside: Float[np.ndarray, "cells 2"] | float = 0.0) -> np.ndarray:
        return motion.rule.part(np.stack([start + aside, end + aside], axis=1))

    # If a step touches a wall on one side only, it is free after a small shift to the other side.
    side = 10 * near * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    beside = shapely.covers(grown, parts(side)) | shapely.covers(grown, parts(-side))
    touches = shapely.covers(grown, parts())
    free = shapely.covers(shrunk, parts()) | (touches & beside)
    clear = ~inside | free | ~touches
    ends = cells.position_of_square[row, column]
    return np.where(inside & free, ends, z % cells.positions), clear


def compare_straight(
    cells: CellSpace, only: Int[np.ndarray, "cells"] | None = None, motion: Motion = CELL_BY_CELL
) -> tuple[SimpleMap, Comparison]:
    """Compute the cell map of the bouncing angle 0, and check it with [`compare_images`][]."""
    straight = bouncing.bounce_map(cells, 0.0, motion=motion)
    return straight, compare_images(cells, straight, 0.0, only=only, motion=motion)


def compare_groups(groups: BounceGroups) -> list[Comparison]:
    """Compare periodic groups with the components of the graph that joins cells to their images."""
    compared = []
    for i, bounce in enumerate(groups.bounce.tolist()):
        mapped = bouncing.bounce_map(groups.cells, bounce, motion=groups.motion)
        compared.append(compare_images(groups.cells, mapped, bounce, motion=groups.motion))
        by_group, away, around = _components(np.asarray(mapped.image))
        wrong = [
            f"cell {z}: its {name} is {ours[z]}, and {again[z]} by components"
            for name, again in (("group", by_group), ("step", away), ("period", around))
            for ours in [getattr(groups, name)[i].ravel()]
            for z in np.flatnonzero(ours != again).tolist()
        ]
        what = "groups of cells, by components of the graph of images"
        compared.append(Comparison.exact(what, wrong, 3 * groups.cells.size))
        basin, periods = np.bincount(by_group), around[np.unique(by_group, return_index=True)[1]]
        numbers = {
            "count": basin.size,
            "longest_transient": away.max(),
            "shortest_period": periods.min(),
            "longest_period": periods.max(),
            "periodic_cells": periods.sum(),
            "largest_basin": basin.max(),
        }
        ours, what = [getattr(groups, name)[i] for name in numbers], "numbers of the groups"
        compared.append(Comparison.close(f"{what}, by components", ours, [*numbers.values()], 0.0))
    return compared


def _components(
    image: Int[np.ndarray, "cells"],
) -> tuple[Int[np.ndarray, "cells"], Float[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
    """Find the group of each cell, the number of steps to the group, and its period."""
    size = image.size
    graph = scipy.sparse.csr_array((np.ones(size), image, np.arange(size + 1)), shape=(size, size))
    _, basin = csgraph.connected_components(graph, directed=False)
    _, ring = csgraph.connected_components(graph, connection="strong")
    length = np.bincount(ring)[ring]
    periodic = np.flatnonzero((length > 1) | (image == np.arange(size)))
    # Groups are numbered by their smallest cells.
    basins, first = np.unique(basin[periodic], return_index=True)
    number, period = np.empty((2, len(basins)), np.int64)
    number[basins[np.argsort(first)]] = np.arange(len(basins))
    period[basins] = length[periodic[first]]
    step = csgraph.dijkstra(graph.T.tocsr(), indices=periodic, min_only=True, unweighted=True)
    return number[basin], step, period[basin]
