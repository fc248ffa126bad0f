"""The words of a caller about files whose own words are wrong or missing."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .axes.dimensions import axis_kind
from .axes.times import is_time
from .netcdf import OceanFile


_AXES = ("time", "depth", "y", "x", "y_rho", "x_rho", "y_v", "x_u")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Said:
    """The arguments of [`open_currents`][] of the same names; `None` where the file decides."""

    dims: Sequence[str] | None = None
    coords: Sequence[str] | None = None
    time_units: str | None = None
    calendar: str | None = None
    mask: str | None = None
    units: str | None = None
    group: str | None = None

    @property
    def _axes(self) -> dict[str, str]:
        """The axis of each dimension that the caller named."""
        return dict(dim.partition("=")[::2] for dim in self.dims or ())

    def named(self, file: OceanFile) -> OceanFile:
        """Rename the dimensions of one file, and give its times the unit and the calendar."""
        if wrong := set(self._axes.values()) - {*_AXES}:
            raise file.error("dims", f"expected NAME=AXIS with {', '.join(_AXES)}, got {wrong}")
        dataset = file.dataset
        dataset = dataset.rename({d: axis for d, axis in self._axes.items() if d in dataset.dims})
        about = {"units": self.time_units, "calendar": self.calendar}
        if given := {key: value for key, value in about.items() if value}:
            times = [name for name in map(str, dataset.variables) if is_time(dataset, name)]
            for dim in map(str, dataset.dims):
                alone = not any(dataset[name].dims == (dim,) for name in times)
                if alone and axis_kind(dataset, dim) == "time":
                    dataset[dim] = dim, np.arange(dataset.sizes[dim])
                    times.append(dim)
            for name in times:
                dataset[name] = dataset[name].assign_attrs(given)
        return dataclasses.replace(file, dataset=dataset)

    def placed(self, file: OceanFile) -> OceanFile:
        """Give all files together their positions, depths and mask."""
        dataset, positions = file.dataset, tuple(self.coords or ())
        for dim, axis in self._axes.items():
            if axis not in dataset.dims:
                listed = ", ".join(map(str, dataset.dims))
                raise file.error("dims", f"{dim!r} is not a dimension; the file has {listed}")
        named, value = (self.mask or "").partition("=")[::2]
        for option, name in (*(("coords", name) for name in positions), ("mask", named)):
            if name and name not in dataset.variables:
                known = ", ".join(map(str, dataset.variables))
                raise file.error(option, f"{name!r} is not in the file, which has {known}")
        if positions and not 2 <= len(positions) <= 3:
            raise file.error("coords", f"expected LON LAT or LON LAT DEPTH, got {self.coords}")
        for name in positions[2:]:
            levels = dataset[name].reset_coords(drop=True).assign_attrs(axis="Z")
            dataset = dataset.assign_coords({levels.dims[0]: levels})
        try:
            land = (named, float(value)) if self.mask else None
        except ValueError:
            raise file.error("mask", f"expected VAR=VALUE of land, got {self.mask!r}") from None
        return dataclasses.replace(file, dataset=dataset, positions=positions, land=land)
