"""The velocity on the cells of a grid, layer by layer, and the mask of the water."""

import dataclasses
import functools
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from .axes.depths import Layers
from .component import FASTEST_CURRENT, Component, component, read_cells
from .conventions import find
from .flags import LEAST_PRESENT, fill_gaps
from .grid import OceanGrid
from .land import Land, read_land
from .masks import Mask, read_mask
from .models.roms import SLevels, at_height, formula_terms
from .netcdf import OceanFile
from .velocity import Velocity


_Levels: TypeAlias = Float[np.ndarray, "levels y x"]
_Layers: TypeAlias = Float[np.ndarray, "layers y x"]
_Mask: TypeAlias = Bool[np.ndarray, "layers y x"]


@dataclasses.dataclass(frozen=True)
class Field:
    """The velocity on the cells of each layer, and the masks of water and land."""

    depth: Float[np.ndarray, " layers"]
    "The depth of each layer, in metres."
    u: Float[np.ndarray, "kept layers y x"]
    v: Float[np.ndarray, "kept layers y x"]
    "The components of the velocity in m/s, per record or averaged; NaN where there is no water."
    water: Bool[np.ndarray, "layers y x"]
    "The cells of water: those with a velocity at a share `LEAST_PRESENT` of the records or more."
    land: Bool[np.ndarray, "layers y x"]
    "True on land and sea bed. A grid square that is neither land nor water is sea without data."
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    "The notes on decisions about values of the file on which the answer depends."


@dataclasses.dataclass(frozen=True)
class FieldReader:
    """A reader of a chosen part of a file: its velocity, and the masks of water and land."""

    file: OceanFile
    velocity: Velocity
    grid: OceanGrid
    records: Int[np.ndarray, " records"]
    times: Shaped[np.ndarray, " records"]
    layers: Layers
    coast: Land | None = None
    "The land for files without a mask; by default the land of Natural Earth."
    gaps: str = "open"
    '`"open"` if squares without a velocity may be sea, an open edge; `"land"` if all are land.'

    @property
    def names(self) -> str:
        """The names of the components, for messages."""
        return f"{self.velocity.u}, {self.velocity.v}"

    @functools.cached_property
    def components(self) -> list[Component]:
        return self.at_levels(self.layers.places)

    def at_levels(self, places: Int[np.ndarray, " levels"] | None) -> list[Component]:
        """Build the readers of both components at some levels."""
        both = ((self.velocity.u, self.velocity.u_axes), (self.velocity.v, self.velocity.v_axes))
        return [component(self.file, name, axes, self.grid, places) for name, axes in both]

    @functools.cached_property
    def mask(self) -> Mask | None:
        """The mask of the water at the cell centres, or `None` if the file has no mask."""
        axes, places = self.velocity.u_axes, self.layers.places
        return read_mask(self.file, axes.rho, self.grid.rows, self.grid.columns, places, axes.depth)

    @functools.cached_property
    def bed(self) -> Float[np.ndarray, "y x"]:
        """The depth of the sea bed in metres, NaN if unknown."""
        axes, variables = self.velocity.u_axes, self.file.dataset.variables.items()
        on_cells = (str(name) for name, v in variables if set(v.dims) == set(axes.rho))
        terms = formula_terms(self.file, axes.depth)
        if name := terms.get("depth") or find(self.file.dataset, "bed", on_cells):
            return read_cells(self.file, name, axes, self.grid)
        if self.layers.s_levels is not None:
            raise self.file.error("h", "missing; without the depth of the sea the levels have none")
        return np.full(self.grid.lon.shape, np.nan)

    @functools.cached_property
    def surface(self) -> str | None:
        """The variable with the height of the sea surface; `None` if levels do not follow it."""
        if self.layers.s_levels is None:
            return None
        terms, dataset = formula_terms(self.file, self.velocity.u_axes.depth), self.file.dataset
        return terms.get("eta") or find(dataset, "surface", map(str, dataset.variables))

    def read(self, mean: bool = False) -> Field:
        """Read the velocity at the cell centres, without rotating it to East and North.

        With `mean`, records are added to an average one by one, so that only one is in memory.
        """
        layers, records = self.layers, len(self.records)
        shape = (1 if mean else records, len(layers.depth), *self.grid.lon.shape)
        sizes = dict(zip(("time", "layer", "y", "x"), shape, strict=True))
        self.file.check_size(self.names, sizes, arrays=2)
        if layers.s_levels is not None:  # a record at all levels, and arrays of the interpolation
            levels = sizes | {"time": 1, "layer": len(layers.s_levels.s)}
            self.file.check_size(self.names, levels, arrays=10)
        notes, doubts = self._notes(), []
        u, v = np.zeros(shape), np.zeros(shape)
        count, dry, still = (np.zeros(shape[1:], kind) for kind in (int, bool, int))
        moving = np.zeros((records, len(layers.depth)), bool)
        is_water, moves, moves_unmasked = (np.zeros(shape[2:], bool) for _ in range(3))
        for k, record in enumerate(map(int, self.records)):
            (x, beside_x, free_x), (y, beside_y, free_y) = (c.at(record) for c in self.components)
            wet = beside_x | beside_y
            if self.mask is not None:
                wet = np.broadcast_to(self.mask.water, x.shape)
            wet = wet & ~self.grid.closed[:, None]
            x, y = np.where(wet, x, np.nan), np.where(wet, y, np.nan)
            is_water |= wet.any(axis=0)
            moves |= _moves(x, y)
            moves_unmasked |= _moves(free_x, free_y)
            x, y, deep = self._on_layers(x, y, record)
            present = np.isfinite(x) & np.isfinite(y)
            count += present
            still += (x == 0) & (y == 0)
            dry |= deep
            moving[k] = present.any(axis=(1, 2))
            if mean:
                u[0, present] += x[present]
                v[0, present] += y[present]
            else:
                u[k], v[k] = x, y
        if is_water.any() and moves_unmasked.any() and not moves.any():
            raise self._exchanged(is_water, moves_unmasked)
        always = count == records
        gaps = (count >= LEAST_PRESENT * records - 1e-9) & ~dry & ~always
        if mean:
            u, v = u / np.maximum(count, 1), v / np.maximum(count, 1)
            notes.append(f"{self.names}: the mean of {records} records")
        elif gaps.any():
            present = np.isfinite(u) & np.isfinite(v)
            for values in (u, v):
                fill_gaps(values, present, self.times, gaps)
        if gaps.any():
            filled = "left out of the mean" if mean else "interpolated in time"
            lack = f"lack a velocity at up to {1 - LEAST_PRESENT:.0%} of the {records} records"
            doubts.append(f"{gaps.sum():,} cells {lack}, and are water: their gaps are {filled}")
        seen, water = count > 0, always | gaps
        if moves.any():
            ashore, bed, why = self._stored_as_zero(seen & (still == count), water)
            seen, water, dry = seen & ~(ashore | bed), water & ~(ashore | bed), dry | bed
            doubts += why
        kept = self._with_water(water, moving)
        if not kept.all():
            omitted = ", ".join(f"{depth:g}" for depth in layers.depth[~kept])
            notes.append(f"left out, as no cell has water there: {omitted} m")
        if sometimes := int((seen & ~water).sum()):
            have = f"have a velocity at some of the {records} records only"
            doubts.append(f"{sometimes:,} cells {have}, and are not water")
        u, v = (np.where(water, values, np.nan)[:, kept] for values in (u, v))
        land, why = self._land(seen, dry, water)
        doubts += why
        notes, depth = [*notes, *doubts], layers.depth[kept]
        return Field(depth, u, v, water[kept], land[kept], tuple(notes), tuple(doubts))

    def _stored_as_zero(self, zero: _Mask, water: _Mask) -> tuple[_Mask, _Mask, list[str]]:
        """Mark land and sea bed among the squares whose velocity is exactly 0 at all records.

        In a file without a mask, such squares are land if the depth of the sea bed or the coastline
        says so. They are sea bed below squares that move, if the file has a velocity everywhere.
        """
        zero, by = zero & water, ""
        ashore = bed = np.zeros_like(zero)
        if self.mask is not None:
            by = self.mask.name
        elif zero.any():
            land, by = self._coast(np.asarray(zero.any(axis=0)))
            moving_above = np.cumsum(water & ~zero, axis=0) > 0
            still_below = np.logical_and.accumulate(zero[::-1])[::-1]
            ashore, bed = zero & land, moving_above & still_below & water.all()
        rest = zero & ~(ashore | bed)
        counts = {
            f"are land by {by}, and count as land": ashore,
            "lie below others that move, and count as sea bed": bed & ~ashore,
            f"are water by {by}, and count as water that drifters never leave": rest,
        }
        doubts = [
            f"{count:,} squares have a velocity of exactly 0 at all records; they {what}"
            for what, squares in counts.items()
            if (count := int(squares.sum()))
        ]
        return ashore, bed, doubts

    def _coast(self, chosen: Bool[np.ndarray, "y x"]) -> tuple[Bool[np.ndarray, "y x"], str]:
        """Mark land among the `chosen` squares of a file without a mask; name what decides."""
        if (dry := ~(self.bed > 0)).any() and not dry.all():
            return dry, "the depth of the sea bed"
        coast = self.coast or read_land()
        return coast.within(self.grid, chosen), coast.name

    def _land(self, seen: _Mask, deep: _Mask, water: _Mask) -> tuple[_Mask, list[str]]:
        """Mark land and sea bed among squares without water; `seen` ones have some velocity."""
        above = np.cumsum(seen, axis=0) > seen
        if (top := self.layers.top) is not None:
            above |= self._seen_at(top)
        bed = ~seen & (deep | above)
        unknown = ~(water | seen | bed | self.grid.closed[:, None])
        if self.gaps == "land":
            return ~water, []
        if not unknown.any():
            land, by = np.zeros(self.grid.lon.shape, bool), ""
        elif self.mask is not None:
            land, by = ~self.mask.water, self.mask.name
        else:
            land, by = self._coast(unknown.any(axis=0))
        land = ~water & (bed | self.grid.closed[:, None] | (unknown & land))
        if not (gaps := ~(water | land)).any():
            return land, []
        dry = f"{int(land[0].sum())} squares of the first layer are land{by and f' (by {by})'}"
        where = "sea without data, where drifters leave the map"
        return land, [f"{dry}, and {int(gaps[0].sum())} are {where}"]

    def _seen_at(self, level: int) -> Bool[np.ndarray, "y x"]:
        """Mark the cells with a velocity at a level, at the first record."""
        both = self.at_levels(np.array([level]))
        values = [component.at(int(self.records[0]))[0] for component in both]
        return np.all([np.isfinite(value[0]) for value in values], axis=0)

    def _notes(self) -> list[str]:
        """Describe the mask, the surface, the cell faces and the flags of the velocity."""
        notes = [] if self.mask is None else [f"{self.mask.name}: {self.mask.why}"]
        if self.layers.s_levels is not None and self.surface is None:
            notes.append("zeta: the file has none; the surface is taken as flat")
        if self.velocity.u_axes.staggered:
            notes.append(f"{self.names}: averaged from the sides of the cells to their centres")
        notes += [component.valid_note for component in self.components if component.valid_note]
        # Both components may have the same flag.
        flags = (flag.note for component in self.components for flag in component.flags)
        return notes + list(dict.fromkeys(flags))

    def _on_layers(self, x: _Levels, y: _Levels, record: int) -> tuple[_Layers, _Layers, _Mask]:
        """Interpolate a velocity from levels to layers, and mark the squares below the sea bed."""
        surface = np.zeros(self.bed.shape)
        if self.surface is not None:
            axes = self.velocity.u_axes
            surface = read_cells(self.file, self.surface, axes, self.grid, record)
        depth = self.layers.depth[:, None, None]
        deep = depth > self.bed + surface
        if (levels := self.layers.s_levels) is not None:
            heights, wanted = levels.heights(self.bed, surface), surface - depth
            known = np.isfinite(x + y).any(axis=0) & ~deep
            self._check_reach(levels, heights, np.where(known, wanted, np.nan))
            x, y = (
                np.stack([at_height(values, heights, height) for height in wanted])
                for values in (x, y)
            )
        return np.where(deep, np.nan, x), np.where(deep, np.nan, y), deep

    def _exchanged(
        self, is_water: Bool[np.ndarray, "y x"], moves_unmasked: Bool[np.ndarray, "y x"]
    ) -> ValueError:
        """Return the error for a mask in which land and water seem to be swapped."""
        masks = [self.mask, *(component.mask for component in self.components)]
        why = {mask.name: mask.why for mask in masks if mask}
        return self.file.error(
            ", ".join(why),
            f"none of the {is_water.sum()} cells that are water by it has a current other than 0, "
            f"but {(moves_unmasked & ~is_water).sum()} of the {(~is_water).sum()} that are land "
            f"have; are land and water exchanged? ({'; '.join(dict.fromkeys(why.values()))})",
        )

    def _check_reach(self, levels: SLevels, heights: _Levels, wanted: _Layers) -> None:
        """Raise if a `wanted` height is beyond all levels by more than the thickness of a layer."""
        for depth, height in zip(self.layers.depth, wanted, strict=True):
            gap, layer = levels.beyond(heights, height)
            far = np.where(gap > layer, gap, 0)
            if not far.any():
                continue
            cell, s = np.unravel_index(far.argmax(), far.shape), levels.s
            has = f"{s[0]:g} only" if len(s) == 1 else f"{len(s)} levels from {s[0]:g} to {s[-1]:g}"
            raise self.file.error(
                "depths",
                f"{depth:g} m below the surface is {gap[cell]:.3g} m away from the nearest level "
                f"of the file at {self.grid.place(*cell)}; expected a layer "
                f"({layer[cell]:.3g} m there) at most; {self.velocity.u_axes.depth} has {has}",
            )

    def _with_water(
        self, water: _Mask, has_velocity: Bool[np.ndarray, "records layers"]
    ) -> Bool[np.ndarray, " layers"]:
        """Mark the layers with water; refuse dry ones that were chosen, or have some velocity."""
        kept = np.asarray(water.any(axis=(1, 2)))
        for k in np.flatnonzero(~kept):
            if self.layers.asked or not kept.any() or has_velocity[:, k].any():
                raise self.file.error(*self._why_dry(self.layers.depth[k], has_velocity[:, k]))
        return kept

    def _why_dry(self, depth: float, moving: Bool[np.ndarray, " records"]) -> tuple[str, str]:
        """Find the argument, and the reason, for which a layer has no water."""
        if moving.all():
            why = f"no cell has a velocity at each of the {len(moving)} records; choose fewer"
            return "time", why
        if moving.any():
            record = self.records[~moving][0]
            return "time", f"record {record} has no velocity anywhere; leave it out"
        wet = np.isfinite(self.bed)
        if self.mask is not None:
            wet &= self.mask.water.any(axis=0)
        if wet.any() and depth > (deepest := self.bed[wet].max()):
            why = f"{depth:g} m is below the sea bed everywhere: it is {deepest:g} m at most"
            return "depths", why
        if depth > 0:
            return "depths", f"{depth:g} m: no cell has water at that depth"
        return self.names, "every cell is land or has no value; expected some water"


def _moves(x: _Levels, y: _Levels) -> Bool[np.ndarray, "y x"]:
    """Mark the cells whose current is not 0 at some level."""
    speed = np.hypot(x, y)
    return ((speed > 0) & (speed <= FASTEST_CURRENT)).any(axis=0)
