"""Currents as a speed and a direction, clockwise from the North."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..conventions import find
from ..netcdf import OceanFile


NAMES = ("eastward", "northward")
"The names of the components that are computed."


def on_components(file: OceanFile, variables: Sequence[str] | None) -> OceanFile:
    """Add the components of a speed and a direction, in a file without other velocities."""
    dataset = file.dataset
    names = [str(name) for name in dataset.data_vars]
    if variables is not None:
        names = [name for name in variables if name in dataset.variables]
    speed, direction = find(dataset, "speed", names), find(dataset, "direction", names)
    if variables is not None and direction is not None and speed is None:
        speed = next((name for name in names if name != direction), None)
    if speed is None or direction is None:
        return file
    angle, about = file.read(dataset[direction]), dataset[direction].attrs
    if not str(about.get("units", "")).lower().startswith("rad"):
        angle = np.radians(angle)
    comes = "from" in f"{about.get('standard_name')} {about.get('long_name')}".lower()
    away = (-1 if comes else 1) * file.read(dataset[speed])
    components = {}
    for name, turn in zip(NAMES, (np.sin(angle), np.cos(angle)), strict=True):
        components[name] = dataset[speed].variable.copy(data=away * turn)
        components[name].attrs["standard_name"] = f"{name}_sea_water_velocity"
    return dataclasses.replace(file, dataset=dataset.assign(components))
