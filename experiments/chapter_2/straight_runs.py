"""Drive robots straight from wall to wall, by rays that share no code with the library.

After a bump the robot turns to the left from its heading. If the new heading points into the wall,
the length of the next run is 0. A robot may drive along a wall. A ray that grazes a corner goes on,
but does not slip between two walls that meet in a point.
"""

import math

import numpy as np
import shapely


# Tolerances: metres between a ray and a corner on it, and the sine of the angle of parallels.
NEAR, PARALLEL = 1e-9, 1e-12
# The number of pairs of a robot and a wall in a batch.
PAIRS = 2**21


class Rays:
    """The walls of a room, for rays between them.

    The place of a robot is -1 in the interior, the number of a wall, or, in a corner, the number of
    the wall that starts in the corner plus the number of walls.
    """

    def __init__(self, free_space: shapely.Geometry) -> None:
        before, start, end = [], [], []
        for polygon in shapely.get_parts(shapely.orient_polygons(free_space)):
            for ring in shapely.get_rings(polygon):
                corners = shapely.get_coordinates(ring)[:-1]
                before.append(np.roll(corners, 1, 0))
                start.append(corners)
                end.append(np.roll(corners, -1, 0))
        self.start = np.concatenate(start)
        self.walls = len(self.start)
        self.along, self.length = _unit(np.concatenate(end) - self.start)
        self.back, _ = _unit(np.concatenate(before) - self.start)
        # The free space at a point where several corners meet is a wedge for each corner.
        _, self.point, count = np.unique(
            self.start.round(9), axis=0, return_inverse=True, return_counts=True
        )
        for several in np.flatnonzero(count > 1):
            here = np.flatnonzero(self.point == several)
            turn = _angle(self.back[here]) - _angle(self.along[here])[:, None]
            self.back[here] = self.back[here][(turn % math.tau).argmin(axis=1)]
        self.normal = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)

    def run(
        self, point: np.ndarray, at: np.ndarray, heading: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Drive robots to a wall, and return the lengths, the points `[robots, 2]` and the places.

        **Arguments:**

        - `point`: points of the robots, `[robots, 2]`.
        - `at`: places of the robots.
        """
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        length, there = np.zeros(len(point)), at.copy()
        wall = np.where(at < 0, 0, at % self.walls)
        away = (at < 0) | (_dot(self.normal[wall], u) >= -PARALLEL)
        moving = np.flatnonzero(np.where(at >= self.walls, self._opens(wall, u), away))
        for some in np.array_split(moving, -(-moving.size * self.walls // PAIRS) or 1):
            length[some], there[some] = self._hits(point[some], u[some])
        end = point + length[:, None] * u
        # Points are moved exactly onto the wall or the corner, so that rounding does not add up.
        wall = there % self.walls
        arc = np.where(there >= self.walls, 0, _dot(end - self.start[wall], self.along[wall]))
        onto = self.start[wall] + arc[:, None] * self.along[wall]
        return length, np.where((length > 0)[:, None], onto, point), there

    def _hits(self, point: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the distances along the directions `u` to the next places, and these places."""
        offset = self.start - point[:, None]
        into = u @ self.normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = _dot(offset, self.normal) / into
            arc = far * (u @ self.along.T) - _dot(offset, self.along)
            hit = (into < -PARALLEL) & (far > NEAR) & (arc > NEAR) & (arc < self.length - NEAR)
        far = np.where(hit, far, np.inf)
        wall = far.argmin(axis=1)
        far = far[np.arange(len(point)), wall]
        ahead, aside = _dot(offset, u[:, None]), _cross(u[:, None], offset)
        robots, corners = np.nonzero((ahead > NEAR) & (np.abs(aside) <= NEAR))
        came = self._opens(corners, -u[robots])
        at = robots * self.walls + self.point[corners]
        grazed = np.isin(at, at[came & self._opens(corners, u[robots])])
        for robot, corner in zip(robots[came & ~grazed], corners[came & ~grazed], strict=True):
            if ahead[robot, corner] < far[robot]:
                far[robot], wall[robot] = ahead[robot, corner], self.walls + corner
        return far, wall

    def _opens(self, corner: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Test whether each direction leads from its corner into the free space or along a wall."""
        convex = _cross(self.along[corner], self.back[corner]) > PARALLEL
        left = _cross(self.along[corner], u) >= -PARALLEL
        right = _cross(u, self.back[corner]) >= -PARALLEL
        return np.where(convex, left & right, left | right)


def anywhere(free_space: shapely.Geometry, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw points uniformly from the free space."""
    left, bottom, right, top = free_space.bounds
    shapely.prepare(free_space)
    found = np.empty((0, 2))
    while len(found) < count:
        points = rng.uniform((left, bottom), (right, top), (count, 2))
        found = np.concatenate([found, points[shapely.contains_xy(free_space, points)]])
    return found[:count]


def _unit(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    length = np.hypot(*vector.T)
    return vector / length[:, None], length


def _angle(vector: np.ndarray) -> np.ndarray:
    return np.arctan2(vector[:, 1], vector[:, 0])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
