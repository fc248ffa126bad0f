"""Makes the drifters of this folder: `python data/ocean/make_drifters.py [FOLDER]`.

The same bytes come out on every machine. README.md says what is in the file.
"""

import sys
from pathlib import Path

import netCDF4
import numpy as np


DRIFTERS, MOVES, LAG = 200, 40, 5  # of a drifter at most, and the days of a move
STEPS = 20  # in a move
WEST, SOUTH, HIGH = -60.0, 20.0, 12.0  # degrees; the sea is twice as wide as it is high
SPEED = 1.2  # degrees a day at most, round the gyres
INWARD = 0.04  # of the part that goes round
SPREAD = 0.12  # degrees in the square root of a day
LIVES = 150  # days, on average


def current(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two gyres side by side, the left one clockwise, whose water goes slowly to their middles."""
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
            # Coasts are mirrors.
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
    """Write a ragged array, as the Global Drifter Program does, with places as whole numbers."""
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
