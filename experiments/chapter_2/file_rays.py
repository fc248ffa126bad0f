"""Drive robots straight among the polygons of a map file, without the geometry of the library.

The vertices are those of the file. Polygons are neither joined nor rounded, and the margin
around a disc robot consists of exact segments and circles. A run is found by rays from points
close around the robot, because rays from the robot itself touch corners and run along walls. Where
these rays differ, the robot either stops at the first wall that it touches, or slides past it.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np


# The least distance of the rays from the robot in metres, which is also the sine of the angle of
# parallels, and its least multiple of the spacing of coordinates.
BESIDE, SPACINGS = 1e-10, 50
# The number of rays around a robot. A corner of the free space is wider than the angle between two.
AROUND = 24
# The number of pairs of a ray and an edge in a batch.
PAIRS = 2**21


def rings_of(path: Path) -> tuple[list[np.ndarray], float]:
    """Read the polygons of a map, the boundary first, and the radius of the robot in metres.

    The obstacles of a grid are the rows of its squares that are not free.
    """
    if path.suffix == ".json":
        data = json.loads(path.read_text())
        rings = [np.array(ring, float) for ring in (data["boundary"], *data.get("obstacles", ()))]
        return rings, float(data.get("robot_radius", 0.0))
    solid, side, corner = _squares(path)
    height, width = solid.shape
    boxes = [(0, 0, width, height)]
    for row in range(height):
        ends = np.flatnonzero(np.diff(np.r_[False, solid[row], False].astype(int))).reshape(-1, 2)
        boxes += [(first, row, last, row + 1) for first, last in ends.tolist()]
    return [corner + side * np.array([(a, c), (b, c), (b, d), (a, d)]) for a, c, b, d in boxes], 0.0


def _squares(path: Path) -> tuple[np.ndarray, float, np.ndarray]:
    """Read the squares of a grid that are not free, from the lowest row, with side and corner."""
    lines = path.read_text().splitlines()
    if path.suffix == ".txt":
        side = float(next(line for line in lines if line.startswith("; cell")).split()[2])
        rows = [list(line) for line in lines if line and line[0] != ";"]
        return (np.array(rows) == "#")[::-1], side, np.zeros(2)
    words = dict(line.split(": ", 1) for line in lines if ": " in line)
    _, size, _, pixels = (path.parent / words["image"]).read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    shade = np.frombuffer(pixels, np.uint8).reshape(height, width)
    free = (255 - shade) / 255 < float(words["free_thresh"])
    corner = np.array(json.loads(words["origin"])[:2])
    return ~free[::-1], float(words["resolution"]), corner


def moved(
    rings: list[np.ndarray], turn: float = 0.0, shift: tuple[float, float] = (0, 0), *, mirror=False
) -> list[np.ndarray]:
    """Mirror polygons at the y axis, turn them left by `turn` radians, and shift them."""
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    sides = np.array([-1.0 if mirror else 1.0, 1.0])
    return [ring * sides @ rotation + shift for ring in rings]


class FileRays:
    """The polygons of a map, the boundary first, and a disc robot that drives among them."""

    def __init__(self, rings: list[np.ndarray], radius: float = 0.0) -> None:
        # Robots drive near the origin, where coordinates have more digits.
        self.origin, self.radius = rings[0][0], radius
        self.beside = max(BESIDE, SPACINGS * np.spacing(np.abs(np.concatenate(rings)).max()))
        start, end = [], []
        for number, ring in enumerate(rings):
            x, y = (ring - self.origin).T
            area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
            # The free space is to the left of each edge.
            local = np.stack([x, y], axis=1)[:: 1 if (area > 0) == (number == 0) else -1]
            start.append(local)
            end.append(np.roll(local, -1, axis=0))
        self.sizes = [len(ring) for ring in rings]
        self.start, self.end = np.concatenate(start), np.concatenate(end)
        along = self.end - self.start
        self.length = np.hypot(*along.T)
        self.along = along / self.length[:, None]
        self.normal = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        self.begin = self.start + radius * self.normal

    def anywhere(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw places of the robot's centre uniformly from the free space."""
        low, high = self.start.min(axis=0), self.start.max(axis=0)
        found = np.empty((0, 2))
        while len(found) < count:
            tried = rng.uniform(low, high, (count, 2))
            found = np.concatenate([found, tried[self._free(tried)]])
        return found[:count] + self.origin

    def run(
        self, point: np.ndarray, heading: np.ndarray, stops: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Drive robots to a wall, and return the lengths of the runs and the places.

        A robot that `stops` bumps into the first wall that it touches; another robot slides on.
        """
        length, place = np.empty(len(point)), np.empty((len(point), 2))
        size = max(1, PAIRS // (AROUND * len(self.start)))
        for k in range(0, len(point), size):
            part = slice(k, k + size)
            length[part], place[part] = self._run(
                point[part] - self.origin, heading[part], stops[part]
            )
        return length, place + self.origin

    def _run(
        self, point: np.ndarray, heading: np.ndarray, stops: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        ring = 0.037 + math.tau * np.arange(AROUND) / AROUND
        around = self.beside * np.stack([np.cos(ring), np.sin(ring)], axis=1)
        rays = (point[:, None] + around).reshape(-1, 2)
        free = self._free(rays).reshape(len(point), -1)
        if not free.any(axis=1).all():
            raise ValueError(f"no free space around {point[~free.any(axis=1)][0] + self.origin}")
        met = self._first(rays, np.repeat(u, AROUND, axis=0)).reshape(len(point), -1)
        robot, ray = np.nonzero(free)
        length = np.full(met.shape, np.nan)
        place = np.zeros((*met.shape, 2))
        length[robot, ray], place[robot, ray] = self._exact(point[robot], u[robot], met[robot, ray])
        at = np.where(stops, np.nanargmin(length, axis=1), np.nanargmax(length, axis=1))
        number = np.arange(len(point))
        stays = stops & self._beside(point, u)
        length = np.where(stays, 0.0, length[number, at])
        return length, np.where(stays[:, None], point, place[number, at])

    def _free(self, point: np.ndarray) -> np.ndarray:
        """Test whether the robot fits at each place: by rays to the right, and by distances."""
        x, y = point[:, 0, None], point[:, 1, None]
        (ax, ay), (bx, by) = self.start.T, self.end.T
        with np.errstate(divide="ignore", invalid="ignore"):
            crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
        inside = np.add.reduceat(crosses, np.r_[0, np.cumsum(self.sizes)[:-1]], axis=1) % 2 == 1
        free = inside[:, 0] & ~inside[:, 1:].any(axis=1)
        if self.radius:
            arc = ((point[:, None] - self.start) * self.along).sum(axis=2)
            nearest = self.start + np.clip(arc, 0, self.length)[:, :, None] * self.along
            free &= np.linalg.norm(point[:, None] - nearest, axis=2).min(axis=1) >= self.radius
        return free

    def _first(self, point: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Find the first edge on each ray; circles around vertices follow the edges."""
        offset = point[:, None] - self.begin
        facing = -u @ self.normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (offset * self.normal).sum(axis=2) / facing
            arc = (offset * self.along).sum(axis=2) + far * (u @ self.along.T)
        hit = (facing > self.beside) & (far >= 0) & (arc >= 0) & (arc <= self.length)
        far = np.where(hit, far, np.inf)
        if self.radius:
            offset = point[:, None] - self.start
            middle = -(offset * u[:, None]).sum(axis=2)
            square = middle**2 - (offset**2).sum(axis=2) + self.radius**2
            circle = np.where((square >= 0) & (middle > 0), middle, np.inf)
            far = np.concatenate([far, circle - np.sqrt(np.maximum(square, 0))], axis=1)
        return far.argmin(axis=1)

    def _exact(
        self, point: np.ndarray, u: np.ndarray, met: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the runs from the robots themselves to the edges and circles that rays met."""
        edge = met % len(self.start)
        offset, normal, along = point - self.begin[edge], self.normal[edge], self.along[edge]
        far = (offset * normal).sum(axis=1) / np.maximum(-(u * normal).sum(axis=1), self.beside)
        far = np.maximum(far, 0.0)
        arc = ((offset + far[:, None] * u) * along).sum(axis=1)
        arc = np.clip(arc, 0, self.length[edge])
        place = self.begin[edge] + arc[:, None] * along
        round_ = met >= len(self.start)
        offset = point - self.start[edge]
        middle = -(offset * u).sum(axis=1)
        square = middle**2 - (offset**2).sum(axis=1) + self.radius**2
        circle = np.maximum(middle - np.sqrt(np.maximum(square, 0)), 0.0)
        away = offset + circle[:, None] * u
        away *= self.radius / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), self.beside)
        place = np.where(round_[:, None], self.start[edge] + away, place)
        return np.where(round_, circle, far), place

    def _beside(self, point: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Test whether each robot touches an edge that is parallel to its heading."""
        offset = point[:, None] - self.begin
        near = np.abs((offset * self.normal).sum(axis=2)) < 3 * self.beside
        arc = (offset * self.along).sum(axis=2)
        near &= (arc > -3 * self.beside) & (arc < self.length + 3 * self.beside)
        near &= np.abs(u @ self.normal.T) < self.beside
        robot, edge = np.nonzero(near)
        # An edge in the interior of touching polygons has no free side.
        middle = np.sign(self.length[edge] / 2 - arc[robot, edge])[:, None] * self.along[edge]
        free = self._free(point[robot] + self.beside * (self.normal[edge] + middle))
        return np.isin(np.arange(len(point)), robot[free])


def holds(
    filter: Any, state: Any, place: np.ndarray, heading: np.ndarray, within: float
) -> np.ndarray:
    """Test whether each robot is at most `within` metres from a stretch of its set.

    A heading between two slices belongs to both.
    """
    robot, boundary, chords = state.robot, filter.boundary, filter.chords
    begin = boundary.point(state.wall, state.begin)
    along = boundary.point(state.wall, state.end) - begin
    offset = place[robot] - begin
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    share = np.clip((offset * along).sum(axis=1) / square, 0, 1)
    near = np.linalg.norm(offset - share[:, None] * along, axis=1) <= within
    inside = np.zeros(len(place), bool)
    for by in (-1e-9, 1e-9):
        number = (heading + by) * chords.slices / math.tau
        slices = np.floor(number) if chords.width else np.round(number)
        same = state.slice == (slices.astype(int) % chords.slices)[robot]
        inside |= np.bincount(robot[near & same], minlength=len(place)) > 0
    return inside
