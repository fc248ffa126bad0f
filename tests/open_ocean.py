"""NetCDF files of currents in the open ocean, whose squares without data are no land."""

import netCDF4
import numpy as np


SIDE = 0.02


def write_currents(path, east, north, lon=-150.0, lat=-30.0, side=SIDE):
    """Write a current with a record every 12 hours, far from any coast; NaN is no data."""
    east, north = (field if field.ndim == 3 else field[None] for field in (east, north))
    records, rows, columns = east.shape
    axes = {
        "time": (43_200.0 * np.arange(records), "seconds since 2020-01-01"),
        "latitude": (lat + side * np.arange(rows), "degrees_north"),
        "longitude": (lon + side * np.arange(columns), "degrees_east"),
    }
    with netCDF4.Dataset(path, "w") as file:
        for name, (values, units) in axes.items():
            file.createDimension(name, len(values))
            file.createVariable(name, "f8", (name,))[:] = values
            file[name].units = units
        for name, toward, field in (("uo", "eastward", east), ("vo", "northward", north)):
            variable = file.createVariable(name, "f8", tuple(axes), fill_value=1e20)
            variable[:] = np.ma.masked_invalid(field)
            variable.standard_name, variable.units = f"{toward}_sea_water_velocity", "m s-1"


def eddies(shape=(32, 40), mean=0.3, holes=0.03):
    """Eddies of about ten squares, with a mean speed in m/s and a share of squares without data."""
    random = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(0, 2, shape[1]), np.linspace(0, 1.6, shape[0]))
    stream = np.zeros(shape)
    for k in (1, 2, 3):
        for m in (1, 2, 3):
            a, b = random.uniform(0, 6, 2)
            wave = np.sin(k * np.pi * x + a) * np.sin(m * np.pi * y + b)
            stream += random.normal() * wave
    field = np.stack([-np.gradient(stream, axis=0), np.gradient(stream, axis=1)])
    field *= mean / np.hypot(*field).mean()
    field[:, random.random(shape) < holes] = np.nan
    return field
