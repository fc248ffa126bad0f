"""Make the drifters of this folder: `python data/ocean/make_drifters.py [FOLDER]`.

The file has the same bytes on every machine. README.md describes it.
"""

import sys
from pathlib import Path

import netCDF4
import numpy as np


# The number of drifters, the most moves of a drifter, the days of a move, and its steps.
DRIFTERS, MOVES, LAG = 200, 40, 5
STEPS = 20
WEST, SOUTH, HIGH = -60.0, 20.0, 12.0  # degrees; the sea is twice as wide as it is high
SPEED = 1.2  # degrees per day, the largest speed around the gyres
INWARD = 0.04  # the inward speed, as a share of the speed around a gyre
SPREAD = 0.12  # degrees per square root of a day
LIVES = 150  # mean lifetime in days


def current(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the current in degrees per day: two gyres with a slow flow to their centres."""
    a, b = np.pi * x / HIGH, np.pi * y / HIGH
    sign = np.sign(np.sin(a))
    east = -np.sin(a) * np.cos(b) + INWARD * sign * np.cos(a) * np.sin(b)
    north = np.cos(a) * np.sin(b) + INWARD * sign * np.sin(a) * np.cos(b)
    return SPEED * east, SPEED * north


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    random = np.random.default_rng(5)
    x, y = random.uniform(0, 2 * HIGH, DRIFTERS), random.uniform(0, HIGH, DRIFTERS)
    places = [(x, y)]
    for _ in range(MOVES):
        for _ in range(STEPS):
            days = LAG / STEPS
            east, north = current(x, y)
            x = x + days * east + SPREAD * np.sqrt(days) * random.standard_normal(DRIFTERS)
            y = y + days * north + SPREAD * np.sqrt(days) * random.standard_normal(DRIFTERS)
            # Coasts reflect drifters.
            x = HIGH * 2 - np.abs(2 * HIGH - np.abs(x))
            y = HIGH - np.abs(HIGH - np.abs(y))
        places.append((x, y))
    lives = np.minimum(1 + random.exponential(LIVES / LAG, DRIFTERS).astype(int), MOVES + 1)
    begins = random.integers(0, 200, DRIFTERS)
    number, move = np.nonzero(np.arange(MOVES + 1) < lives[:, None])
    lon, lat = np.array(places)[move, :, number].T
    days = begins[number] + LAG * move
    write(folder / "drifters.nc", lives, WEST + lon, SOUTH + lat, days)


def write(
    path: Path, lives: np.ndarray, lon: np.ndarray, lat: np.ndarray, days: np.ndarray
) -> None:
    """Write a ragged array in the format of the Global Drifter Program, with integer places."""
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.title = "Drifters of no real sea, for jaxcell; made by data/ocean/make_drifters.py"
        file.featureType = "trajectory"
        file.createDimension("traj", lives.size)
        file.createDimension("obs", lon.size)
        row = file.createVariable("rowsize", "i4", "traj")
        row.sample_dimension = "obs"
        row[:] = lives
        time = file.createVariable("time", "i2", "obs")
        time.units = "days since 2020-01-01"
        time[:] = days
        for name, values, of in ("longitude", lon, "east"), ("latitude", lat, "north"):
            one = file.createVariable(name, "i2", "obs")
            one.standard_name, one.units, one.scale_factor = name, f"degrees_{of}", 0.005
            one[:] = values


if __name__ == "__main__":
    main()
