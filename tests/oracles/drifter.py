"""The drift map of Alam 2018, section 5.4.3, cell by cell."""

import numpy as np


SINK = -1


class Drifter:
    """The images of a drifter of one cell after a step, cell by cell in plain NumPy."""

    def __init__(
        self,
        currents,
        water,
        layer,
        duration,
        *,
        rho=0.8,
        spread="turned",
        edge="uniform",
        samples=5,
    ):
        self.water, self.duration, self.rho, self.samples = water, duration, rho, samples
        self.spread, self.exits = spread, edge == "exit"
        east, north = (
            np.nan_to_num(currents[name].isel(layer=layer).values.astype(float)).mean(axis=0)
            for name in "uv"
        )
        wet = water.number >= 0
        cos, sin = np.cos(water.angle), np.sin(water.angle)
        self.rate = [
            np.where(wet, (east * cos + north * sin) / water.dx, 0),
            np.where(wet, (north * cos - east * sin) / water.dy, 0),
        ]

    def images(self, z):
        """The cells and their probabilities; -1 for off the grid."""
        column, row = int(self.water.column[z]), int(self.water.row[z])
        around = [
            self._at(row + up, column + right)
            for up in (-1, 0, 1)
            for right in (-1, 0, 1)
            if up or right
        ]
        beside = [cell for cell in around if cell is not None and cell >= 0]
        if not self.exits and len(beside) < 8:
            return {cell: 1 / (len(beside) + 1) for cell in (z, *beside)}
        if self.spread == "sampled":
            found = {}
            off = (np.arange(self.samples) + 0.5) / self.samples - 0.5
            for up in off:
                for right in off:
                    to = self._landing(z, *self._end(column + right, row + up))
                    found[to] = found.get(to, 0.0) + 1 / self.samples**2
            return found
        x, y = self._end(column, row)
        image = self._landing(z, x, y)
        others = self._turned(z, x, y) if self.spread == "turned" else self._around(z, image, x, y)
        others = [to for to in dict.fromkeys(others) if to != image]
        if not others:
            return {image: 1.0}
        return {image: self.rho, **{to: (1 - self.rho) / len(others) for to in others}}

    def _end(self, x, y):
        rows, columns = self.water.number.shape
        rates, low_x = self.rate, np.clip(x, 0, columns - 1)
        if self.water.wraps:
            # The first column once more, after the last.
            rates, low_x = [np.column_stack([one, one[:, 0]]) for one in rates], x % columns
            columns += 1
        low_y = np.clip(y, 0, rows - 1)
        i, j = min(int(low_x), max(columns - 2, 0)), min(int(low_y), max(rows - 2, 0))
        across, up = low_x - i, low_y - j
        speed = []
        for rate in rates:
            corners = rate[j : j + 2, i : i + 2]
            corners = np.pad(corners, [(0, 2 - s) for s in corners.shape], mode="edge")
            speed.append(np.array([1 - up, up]) @ corners @ np.array([1 - across, across]))
        return x + self.duration * speed[0], y + self.duration * speed[1]

    def _at(self, row, column):
        """The cell in a square: -1 for land, `None` off the grid."""
        rows, columns = self.water.number.shape
        if self.water.wraps:
            column %= columns
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        return int(self.water.number[row, column])

    def _square(self, x, y):
        return int(np.floor(np.round(y + 0.5, 9))), int(np.floor(np.round(x + 0.5, 9)))

    def _landing(self, z, x, y):
        water = self.water
        to = self._at(*self._square(x, y))
        if to is None and self.exits:
            return SINK
        if to is not None and to >= 0 and water.piece[to] == water.piece[z]:
            return to
        here = water.row[z], water.column[z]
        across = np.abs(water.column - x)
        if water.wraps:
            columns = water.number.shape[1]
            across %= columns
            across = np.minimum(across, columns - across)
        away = np.hypot(across * water.dx[here], (water.row - y) * water.dy[here])
        away[water.piece != water.piece[z]] = np.inf
        return int(np.flatnonzero(away <= away.min() * (1 + 1e-9))[0])

    def _turned(self, z, x, y):
        water = self.water
        here = water.row[z], water.column[z]
        side = np.array([water.dx[here], water.dy[here]])
        way = np.array([x - water.column[z], y - water.row[z]]) * side
        found = []
        for angle in (np.pi / 4, -np.pi / 4):
            cos, sin = np.cos(angle), np.sin(angle)
            right, up = np.array([[cos, -sin], [sin, cos]]) @ way / side
            found.append(self._landing(z, water.column[z] + right, water.row[z] + up))
        return found

    def _around(self, z, image, x, y):
        water, found = self.water, []
        row, column = self._square(x, y)
        if image >= 0:
            row, column = int(water.row[image]), int(water.column[image])
        for up in (-1, 0, 1):
            for right in (-1, 0, 1):
                to = self._at(row + up, column + right)
                if to is None and self.exits:
                    found.append(SINK)
                elif to is not None and to >= 0 and water.piece[to] == water.piece[z]:
                    found.append(to)
        return found
