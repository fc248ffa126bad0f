"""The drift map of Alam 2018, section 5.4.3, cell by cell, and drifters by a solver of scipy.

A file is read with netCDF4. Cells, pieces of water, interpolation and steps are those of this
module.
"""

import netCDF4
import numpy as np
from scipy.integrate import solve_ivp
from scipy.ndimage import map_coordinates


SINK = -1
RADIUS = 6_371_000.0


class Current:
    """A current in m/s, `[times, rows, columns]`, NaN on land, on squares with sides in metres."""

    def __init__(self, east, north, dx, dy, *, angle=0.0, seconds=(0.0,), wraps=False):
        self.wet = np.isfinite(east).all(axis=0)
        self.seconds, self.wraps = np.asarray(seconds, float), wraps
        self.dx, self.dy, angle = (np.broadcast_to(one, self.wet.shape) for one in (dx, dy, angle))
        east, north = (np.where(self.wet, one, 0.0) for one in (east, north))
        cos, sin = np.cos(angle), np.sin(angle)
        # In squares per second.
        self.rate = np.stack(
            [(cos * east + sin * north) / self.dx, (cos * north - sin * east) / self.dy], axis=1
        )
        self.squares = [(int(row), int(column)) for row, column in np.argwhere(self.wet)]
        self.number = {square: cell for cell, square in enumerate(self.squares)}
        self.piece = self._pieces()

    @classmethod
    def of(cls, currents, wraps=False):
        """The only layer of currents that a test made."""
        u, v, *grid = (currents[name].values for name in ("u", "v", "dx", "dy", "angle"))
        since = (currents.time.values - currents.time.values[0]) / np.timedelta64(1, "s")
        return cls(u[:, 0], v[:, 0], *grid[:2], angle=grid[2], seconds=since, wraps=wraps)

    @classmethod
    def read(cls, path, layer):
        """A layer of a file on latitudes and longitudes with a record every hour."""
        with netCDF4.Dataset(path) as file:
            u, v = (np.ma.filled(file[name][:, layer].astype(float), np.nan) for name in "uv")
            lon, lat, hours = (np.asarray(file[name][:], float) for name in ("lon", "lat", "time"))
        metres = np.radians(1) * RADIUS
        dx = metres * (lon[1] - lon[0]) * np.cos(np.radians(lat))[:, None]
        return cls(u, v, dx, metres * (lat[1] - lat[0]), seconds=3600 * (hours - hours[0]))

    def mean(self):
        """The rate on average over the records."""
        return self.rate.mean(axis=0)

    def at(self, time):
        """The rate at a time, linear between records."""
        if self.seconds.size == 1:
            return self.rate[0]
        k = int(np.clip(np.searchsorted(self.seconds, time) - 1, 0, self.seconds.size - 2))
        share = (time - self.seconds[k]) / (self.seconds[k + 1] - self.seconds[k])
        share = min(max(share, 0.0), 1.0)
        return (1 - share) * self.rate[k] + share * self.rate[k + 1]

    def between(self, rate, x, y):
        """The rate at points, bilinear between the centres of squares."""
        if self.wraps:
            rate, x = np.concatenate([rate, rate[..., :1]], axis=-1), x % self.wet.shape[1]
        return [map_coordinates(one, [y, x], order=1, mode="nearest") for one in rate]

    def square(self, x, y):
        """The row and column of the square of a point; on an edge, those of the later square."""
        row, column = (int(np.floor(np.round(place + 0.5, 9))) for place in (y, x))
        return row, column % self.wet.shape[1] if self.wraps else column

    def beside(self, row, column):
        """The squares of the grid around a square, with a corner or a side in common."""
        rows, columns = self.wet.shape
        found = []
        for up in (-1, 0, 1):
            for right in (-1, 0, 1):
                there = row + up, (column + right) % columns if self.wraps else column + right
                if (up or right) and there[0] in range(rows) and there[1] in range(columns):
                    found.append(there)
        return found

    def _pieces(self):
        """The first square of the connected water of every square of water."""
        piece = {}
        for first in self.squares:
            reached = [] if first in piece else [first]
            while reached:
                square = reached.pop()
                if square not in piece:
                    piece[square] = first
                    reached += [near for near in self.beside(*square) if self.wet[near]]
        return piece

    def landing(self, origin, x, y, exits):
        """The cell in which a drifter from the square `origin` ends, or `SINK`."""
        row, column = self.square(x, y)
        inside = row in range(self.wet.shape[0]) and column in range(self.wet.shape[1])
        if exits and not inside:
            return SINK
        if inside and self.piece.get((row, column)) == self.piece[origin]:
            return self.number[row, column]
        away = {}
        for square in self.squares:
            across = abs(square[1] - x)
            if self.wraps:
                across %= self.wet.shape[1]
                across = min(across, self.wet.shape[1] - across)
            if self.piece[square] == self.piece[origin]:
                far = np.hypot(across * self.dx[origin], (square[0] - y) * self.dy[origin])
                away[self.number[square]] = far
        least = min(away.values())
        return next(cell for cell in sorted(away) if away[cell] <= least * (1 + 1e-9))

    def solved(self, x, y, start, seconds):
        """The ends of drifters, and how far they have been beyond the edges of the grid, in cells.

        A drifter that has always been on the grid has a distance below 0.
        """
        size, (rows, columns) = len(x), self.wet.shape

        def rate(time, places):
            return np.concatenate(self.between(self.at(time), places[:size], places[size:]))

        times = start + np.linspace(0, seconds, 101)
        found = solve_ivp(
            rate, times[[0, -1]], np.concatenate([x, y]), "DOP853", times, rtol=1e-8, atol=1e-8
        )
        x, y = found.y[:size], found.y[size:]
        beyond = np.max([-0.5 - x, x - columns + 0.5, -0.5 - y, y - rows + 0.5], axis=(0, 2))
        return x[:, -1], y[:, -1], beyond


class Drifter:
    """The images of a drifter of one cell after a step in the mean current."""

    def __init__(self, current, duration, *, rho=0.8, spread="turned", edge="uniform", samples=5):
        self.current, self.duration, self.rho, self.samples = current, duration, rho, samples
        self.spread, self.exits = spread, edge == "exit"

    def images(self, z):
        """The cells and their probabilities; `SINK` for off the grid."""
        current = self.current
        origin = row, column = current.squares[z]
        beside = [current.number[one] for one in current.beside(*origin) if current.wet[one]]
        if not self.exits and len(beside) < 8:
            return {cell: 1 / (len(beside) + 1) for cell in (z, *beside)}
        if self.spread == "sampled":
            found = {}
            off = (np.arange(self.samples) + 0.5) / self.samples - 0.5
            for up in off:
                for right in off:
                    to = self._landing(origin, *self._end(column + right, row + up))
                    found[to] = found.get(to, 0.0) + 1 / self.samples**2
            return found
        x, y = self._end(column, row)
        image = self._landing(origin, x, y)
        others = (
            self._turned(origin, x, y)
            if self.spread == "turned"
            else self._around(origin, image, x, y)
        )
        others = [to for to in dict.fromkeys(others) if to != image]
        if not others:
            return {image: 1.0}
        return {image: self.rho, **{to: (1 - self.rho) / len(others) for to in others}}

    def _end(self, x, y):
        rate = self.current.between(self.current.mean(), np.array([x]), np.array([y]))
        return x + self.duration * rate[0][0], y + self.duration * rate[1][0]

    def _landing(self, origin, x, y):
        return self.current.landing(origin, x, y, self.exits)

    def _turned(self, origin, x, y):
        row, column = origin
        side = np.array([self.current.dx[origin], self.current.dy[origin]])
        way = np.array([x - column, y - row]) * side
        found = []
        for angle in (np.pi / 4, -np.pi / 4):
            cos, sin = np.cos(angle), np.sin(angle)
            right, up = np.array([[cos, -sin], [sin, cos]]) @ way / side
            found.append(self._landing(origin, column + right, row + up))
        return found

    def _around(self, origin, image, x, y):
        current = self.current
        middle = current.square(x, y) if image == SINK else current.squares[image]
        near = [middle, *current.beside(*middle)]
        found = [
            current.number[one] for one in near if current.piece.get(one) == current.piece[origin]
        ]
        # A square on the edge of the grid has fewer than eight squares beside it.
        return [*found, SINK] if self.exits and len(near) < 9 else found
