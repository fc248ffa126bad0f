"""The velocity on the cells of a grid, layer by layer, and the mask of the water."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from .axes.depths import Layers
from .axes.dimensions import Axes
from .component import FASTEST_CURRENT, Component, component, read_cells
from .conventions import find
from .flags import LEAST_PRESENT, fill_gaps
from .grid import OceanGrid
from .masks import Mask, read_mask
from .netcdf import OceanFile
from .roms import at_height
from .velocity import Velocity


@dataclasses.dataclass(frozen=True)
class Field:
    """A velocity on cells."""

    depth: Float[np.ndarray, " layers"]
    "Of the layers in metres."
    u: Float[np.ndarray, "kept layers y x"]
    v: Float[np.ndarray, "kept layers y x"]
    "In m/s, NaN without water; at each record, or the mean."
    water: Bool[np.ndarray, "layers y x"]
    "The cells with a velocity at every record, read or interpolated in time."
    notes: tuple[str, ...]
    "The steps of the reading, in words."


def read_field(
    file: OceanFile,
    velocity: Velocity,
    grid: OceanGrid,
    records: Int[np.ndarray, " records"],
    times: Shaped[np.ndarray, " records"],
    layers: Layers,
    mean: bool = False,
) -> Field:
    """Read the velocity at the centres of the cells, along its axes in the file.

    The mean is accumulated record by record, so only one record is in memory.

    **Raises:** `ValueError` for too much memory, a current above 10 m/s, a block or chosen layer
    without water, a mask with land and water exchanged, or depths beyond the levels of the file.
    """
    names = f"{velocity.u}, {velocity.v}"
    shape = (1 if mean else len(records), len(layers.depth), *grid.lon.shape)
    sizes = dict(zip(("time", "layer", "y", "x"), shape, strict=True))
    file.check_size(names, sizes, arrays=2)
    if layers.s_levels is not None:  # a record at all levels, and the arrays of the interpolation
        file.check_size(names, sizes | {"time": 1, "layer": len(layers.s_levels.s)}, arrays=10)
    axes = velocity.u_axes
    sea, notes = _sea(file, axes, grid, layers)
    components = [
        component(file, name, axes, grid, layers.places)
        for name, axes in ((velocity.u, velocity.u_axes), (velocity.v, velocity.v_axes))
    ]
    if axes.staggered:
        notes.append(f"{names}: averaged from the sides of the cells to their centres")
    # Both components may name one flag.
    notes += dict.fromkeys(flag.note for one in components for flag in one.flags)
    u, v = np.zeros(shape), np.zeros(shape)
    count, dry = np.zeros(shape[1:], int), np.zeros(shape[1:], bool)
    moving = np.zeros((len(records), len(layers.depth)), bool)
    is_water, moves, would_move = (np.zeros(shape[2:], bool) for _ in range(3))
    for k, record in enumerate(map(int, records)):
        (x, beside_x, free_x), (y, beside_y, free_y) = (each.at(record) for each in components)
        wet = beside_x | beside_y
        if sea.mask is not None:
            wet = np.broadcast_to(sea.mask.water, x.shape)
        wet = wet & ~grid.closed[:, None]
        x, y = np.where(wet, x, np.nan), np.where(wet, y, np.nan)
        is_water |= wet.any(axis=0)
        moves |= _moves(x, y)
        would_move |= _moves(free_x, free_y)
        surface = np.zeros(shape[2:])
        if sea.surface is not None:
            surface = read_cells(file, sea.surface, axes, grid, record)
        deep = layers.depth[:, None, None] > sea.bed + surface
        if layers.s_levels is not None:
            heights = layers.s_levels.heights(sea.bed, surface)
            wanted = surface - layers.depth[:, None, None]
            known = np.isfinite(x + y).any(axis=0) & ~deep
            _check_reach(file, axes, grid, layers, heights, np.where(known, wanted, np.nan))
            x, y = (
                np.stack([at_height(values, heights, height) for height in wanted])
                for values in (x, y)
            )
        x, y = np.where(deep, np.nan, x), np.where(deep, np.nan, y)
        present = np.isfinite(x) & np.isfinite(y)
        count += present
        dry |= deep
        moving[k] = present.any(axis=(1, 2))
        if mean:
            u[0, present] += x[present]
            v[0, present] += y[present]
        else:
            u[k], v[k] = x, y
    if is_water.any() and would_move.any() and not moves.any():
        raise _exchanged(file, sea, components, is_water, would_move)
    always = count == len(records)
    gaps = (count >= LEAST_PRESENT * len(records) - 1e-9) & ~dry & ~always
    if mean:
        u, v = u / np.maximum(count, 1), v / np.maximum(count, 1)
        notes.append(f"{names}: the mean of {len(records)} records")
    elif gaps.any():
        present = np.isfinite(u) & np.isfinite(v)
        for values in (u, v):
            fill_gaps(values, present, times, gaps)
    if gaps.any():
        filled = "left out of the mean" if mean else "interpolated in time"
        notes.append(
            f"{int(gaps.sum())} cells lack a velocity at up to {1 - LEAST_PRESENT:.0%} of the "
            f"{len(records)} records, and are water: what is missing is {filled}"
        )
    seen = _Seen(always | gaps, count > 0, moving)
    return _with_water(file, velocity, records, layers, sea, u, v, seen, notes)


def _moves(
    x: Float[np.ndarray, "levels y x"], y: Float[np.ndarray, "levels y x"]
) -> Bool[np.ndarray, "y x"]:
    """Mark the cells with a current other than 0 at some level."""
    speed = np.hypot(x, y)
    return ((speed > 0) & (speed <= FASTEST_CURRENT)).any(axis=0)


def _exchanged(
    file: OceanFile,
    sea: "_Sea",
    components: list[Component],
    is_water: Bool[np.ndarray, "y x"],
    would_move: Bool[np.ndarray, "y x"],
) -> ValueError:
    """Return the error for masks that leave no current, although the file has some."""
    masks = {mask.name: mask.why for mask in (sea.mask, *(one.mask for one in components)) if mask}
    return file.error(
        ", ".join(masks),
        f"none of the {is_water.sum()} cells that are water by it has a current other than 0, but "
        f"{(would_move & ~is_water).sum()} of the {(~is_water).sum()} that are land have; are land "
        f"and water exchanged? ({'; '.join(dict.fromkeys(masks.values()))})",
    )


def _check_reach(
    file: OceanFile,
    axes: Axes,
    grid: OceanGrid,
    layers: Layers,
    heights: Float[np.ndarray, "levels y x"],
    wanted: Float[np.ndarray, "layers y x"],
) -> None:
    """Refuse heights that are more than a layer above or below the levels of the file."""
    levels = layers.s_levels
    assert levels is not None
    for depth, height in zip(layers.depth, wanted, strict=True):
        gap, layer = levels.beyond(heights, height)
        far = gap > layer
        if not far.any():
            continue
        row, column = np.unravel_index(np.where(far, gap, 0).argmax(), far.shape)
        s = levels.s
        has = f"{s[0]:g} only" if len(s) == 1 else f"{len(s)} levels from {s[0]:g} to {s[-1]:g}"
        raise file.error(
            "depths",
            f"{depth:g} m below the surface is {gap[row, column]:.3g} m away from the nearest "
            f"level of the file at row {grid.rows[row]}, column {grid.columns[column]}; expected a "
            f"layer ({layer[row, column]:.3g} m there) at most; {axes.depth} has {has}",
        )


@dataclasses.dataclass(frozen=True)
class _Seen:
    """The extent of the velocity in space and time."""

    water: Bool[np.ndarray, "layers y x"]
    "The cells with a velocity at enough records."
    sometimes: Bool[np.ndarray, "layers y x"]
    "The cells with a velocity at any record."
    moving: Bool[np.ndarray, "records layers"]
    "Whether a layer has any velocity at a record."


@dataclasses.dataclass(frozen=True)
class _Sea:
    """The limits of the water in a file."""

    mask: Mask | None
    "Of the centres, or `None` if the file has none."
    bed: Float[np.ndarray, "y x"]
    "The depth of the sea bed in metres, NaN where it is not known."
    surface: str | None
    "The variable of the height of the surface, if it is needed."


def _sea(file: OceanFile, axes: Axes, grid: OceanGrid, layers: Layers) -> tuple[_Sea, list[str]]:
    mask = read_mask(file, axes.rho, grid.rows, grid.columns, layers.places, axes.depth)
    bed, surface, notes = np.full(grid.lon.shape, np.nan), None, []
    if mask is not None:
        notes.append(f"{mask.name}: {mask.why}")
    variables = file.dataset.variables.items()
    on_cells = (str(name) for name, v in variables if set(v.dims) == set(axes.rho))
    name = find(file.dataset, "bed", on_cells)
    if name is not None:
        bed = read_cells(file, name, axes, grid)
    if layers.s_levels is not None:
        if name is None:
            raise file.error("h", "missing; without the depth of the sea the levels have none")
        surface = find(file.dataset, "surface", map(str, file.dataset.variables))
        if surface is None:
            notes.append("zeta: the file has none; the surface is taken as flat")
    return _Sea(mask, bed, surface), notes


def _with_water(
    file: OceanFile,
    velocity: Velocity,
    records: Int[np.ndarray, " records"],
    layers: Layers,
    sea: _Sea,
    u: Float[np.ndarray, "kept layers y x"],
    v: Float[np.ndarray, "kept layers y x"],
    seen: _Seen,
    notes: list[str],
) -> Field:
    """Mark the water, and remove layers without water that were not chosen."""
    water = seen.water
    kept = water.any(axis=(1, 2))
    for k in np.flatnonzero(~kept):
        if layers.asked or not kept.any() or seen.moving[:, k].any():
            somewhere = seen.moving[:, k]
            raise _no_water(file, velocity, records, float(layers.depth[k]), sea, somewhere)
    if not kept.all():
        deep = ", ".join(f"{depth:g}" for depth in layers.depth[~kept])
        notes.append(f"left out, as no cell has water there: {deep} m")
    gaps = int((seen.sometimes & ~water).sum())
    if gaps:
        notes.append(
            f"{gaps} cells have a velocity at some of the {len(records)} records only, and are not "
            "water"
        )
    still = int((water & ((u == 0) & (v == 0)).all(axis=0)).sum())
    if still:
        notes.append(f"{still} water cells have a velocity of exactly 0: land without a mask?")
    u, v = (np.where(water, values, np.nan)[:, kept] for values in (u, v))
    return Field(layers.depth[kept], u, v, water[kept], tuple(notes))


def _no_water(
    file: OceanFile,
    velocity: Velocity,
    records: Int[np.ndarray, " records"],
    depth: float,
    sea: _Sea,
    somewhere: Bool[np.ndarray, " records"],
) -> ValueError:
    if somewhere.all():
        return file.error(
            "time",
            f"no cell has a velocity at each of the {len(records)} records; choose fewer",
        )
    if somewhere.any():
        return file.error(
            "time",
            f"record {records[~somewhere][0]} has no velocity anywhere; leave it out",
        )
    wet = np.isfinite(sea.bed)
    if sea.mask is not None:
        wet &= sea.mask.water.any(axis=0)
    if wet.any() and depth > sea.bed[wet].max():
        return file.error(
            "depths",
            f"{depth:g} m is below the sea bed everywhere: it is {sea.bed[wet].max():g} m at most",
        )
    if depth > 0:
        return file.error("depths", f"{depth:g} m: no cell has water at that depth")
    return file.error(
        f"{velocity.u}, {velocity.v}", "every cell is land or has no value; expected some water"
    )
