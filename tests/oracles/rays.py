"""A robot that drives straight until the wall and turns there, from anywhere in a room.

Plain rays against all walls, in float64 for many robots at once and in fractions for one robot.
Nothing is taken from the library; a room is the coordinates of its free space.

A bump turns the robot to the left by an angle from its heading. Where the new heading points into
the wall, the next run is 0 and the robot turns again. A robot may drive along a wall, and a ray
that grazes a corner goes on; it does not slip between two walls that meet in a point.
"""

import dataclasses
import math
from fractions import Fraction

import numpy as np
import shapely


# Metres within which a ray passes through a corner, and the sine of an angle that is none.
NEAR, PARALLEL = 1e-9, 1e-12
# Pairs of a robot and a wall that are tested at once.
PAIRS = 2**21
INSIDE = -1


def rings_of(free_space):
    """The rings of a polygon or of several; the free space lies to the left of each."""
    rings = []
    for polygon in getattr(free_space, "geoms", [free_space]):
        for outer, ring in enumerate([polygon.exterior, *polygon.interiors]):
            corners = shapely.get_coordinates(ring)[:-1]
            x, y = (corners - corners[0]).T
            ccw = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0
            rings.append(corners if ccw == (outer == 0) else corners[::-1])
    return rings


def corners_of(rings):
    """For each wall its free corner: where the wall before it starts, its own start, and its end.

    Where several corners meet in a point, the wall before is the next one counter-clockwise, so
    that the free space at the point is one wedge for each.
    """
    corners = [
        (before, corner, after)
        for ring in rings
        for before, corner, after in zip(
            [ring[-1], *ring[:-1]], ring, [*ring[1:], ring[0]], strict=True
        )
    ]
    at = {}
    for before, corner, _ in corners:
        at.setdefault(tuple(corner), []).append(before)
    return [
        (min(at[tuple(corner)], key=lambda one: _turn(corner, after, one)), corner, after)
        for _, corner, after in corners
    ]


def _turn(corner, after, before):
    """The angle of the free wedge between two walls, from 0 to a full turn."""
    angles = [math.atan2(to[1] - corner[1], to[0] - corner[0]) for to in (before, after)]
    return (angles[0] - angles[1]) % math.tau


@dataclasses.dataclass
class Runs:
    """Runs of robots from bump to bump; the first index counts the bumps, the second the robots."""

    heading: np.ndarray
    "The heading of each run, in radians."
    length: np.ndarray
    "The length of each run, in metres."
    observed: np.ndarray
    "The length by the robot's own measure."
    point: np.ndarray
    "The place of the bump at the end of the run."
    wall: np.ndarray
    "The wall of that bump, or INSIDE where the bump is in a corner."
    arc: np.ndarray
    "The place along that wall, in metres from its start."


class Room:
    """The walls of a room, and rays between them.

    A place is INSIDE, the number of a wall, or the number of walls plus the number of a corner,
    which is the number of the wall that starts there.
    """

    def __init__(self, free_space):
        rings = rings_of(free_space)
        self.start = np.concatenate(rings)
        self.end = np.concatenate([np.roll(ring, -1, 0) for ring in rings])
        before = np.array([before for before, *_ in corners_of(rings)])
        along = self.end - self.start
        self.length = np.hypot(*along.T)
        self.along = along / self.length[:, None]
        self.normal = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        back = before - self.start
        self.back = back / np.hypot(*back.T)[:, None]
        self.walls = len(self.start)

    def locate(self, point):
        """The place of each point of the closed free space."""
        offset = point[:, None] - self.start
        arc, height = _dot(offset, self.along), np.abs(_dot(offset, self.normal))
        on = (height < NEAR) & (arc > NEAR) & (arc < self.length - NEAR)
        at = np.where(on.any(axis=1), on.argmax(axis=1), INSIDE)
        corner = np.hypot(*np.moveaxis(offset, -1, 0)) <= NEAR
        return np.where(corner.any(axis=1), self.walls + corner.argmax(axis=1), at)

    def leaves(self, at, u):
        """Check whether a robot at each place can start along `u`, which may be along a wall."""
        wall = np.where(at == INSIDE, 0, at % self.walls)
        away = _dot(self.normal[wall], u) >= -PARALLEL
        return np.where(at >= self.walls, self._in_wedge(wall, u), (at == INSIDE) | away)

    def _in_wedge(self, corner, u):
        opens, closes = self.along[corner], self.back[corner]
        convex = _cross(opens, closes) > PARALLEL
        left, right = _cross(opens, u) >= -PARALLEL, _cross(u, closes) >= -PARALLEL
        return np.where(convex, left & right, left | right)

    def cast(self, point, at, heading):
        """Drive robots along their headings: the lengths, the bumps, and the places of these."""
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        length, there = np.zeros(len(point)), at.copy()
        moving = np.flatnonzero(self.leaves(at, u))
        for some in np.array_split(moving, -(-moving.size * self.walls // PAIRS) or 1):
            length[some], there[some] = self._hits(point[some], u[some])
        end = point + length[:, None] * u
        # Exactly onto the wall or the corner, so that rounding does not add up.
        wall = there % self.walls
        arc = _dot(end - self.start[wall], self.along[wall])[:, None]
        arc = np.where((there >= self.walls)[:, None], 0, arc)
        onto = self.start[wall] + arc * self.along[wall]
        end = np.where(((there != INSIDE) & (length > 0))[:, None], onto, point)
        return length, end, there

    def _hits(self, point, u):
        offset = self.start - point[:, None]
        into = self.normal @ u.T
        # To the line of each wall, and where along the wall.
        with np.errstate(divide="ignore", invalid="ignore"):
            far = _dot(offset, self.normal) / into.T
            arc = far * (self.along @ u.T).T - _dot(offset, self.along)
            hit = (into.T < -PARALLEL) & (far > NEAR) & (arc > NEAR) & (arc < self.length - NEAR)
        far = np.where(hit, far, np.inf)
        wall = far.argmin(axis=1)
        far = far[np.arange(len(point)), wall]
        ahead, aside = _dot(offset, u[:, None]), _cross(u[:, None], offset)
        for robot, distance, corner in self._stops(u, ahead, aside):
            if distance < far[robot]:
                far[robot], wall[robot] = distance, self.walls + corner
        if not np.isfinite(far).all():
            raise AssertionError("a ray leaves the room")
        return far, wall

    def _stops(self, u, ahead, aside):
        """The corners that each ray runs into, and does not graze."""
        robot, corner = np.nonzero((ahead > NEAR) & (np.abs(aside) <= NEAR))
        came, goes = self._in_wedge(corner, -u[robot]), self._in_wedge(corner, u[robot])
        # A point where several corners meet is passed within one of them.
        met = {}
        for i, (one, k) in enumerate(zip(robot.tolist(), corner.tolist(), strict=True)):
            met.setdefault((one, *np.round(self.start[k], 9).tolist()), []).append(i)
        for which in met.values():
            if not any(came[i] and goes[i] for i in which):
                i = next((i for i in which if came[i]), which[0])
                yield robot[i], ahead[robot[i], corner[i]], corner[i]

    def drive(self, x, y, heading, turns, *, relative=0.0, absolute=0.0, turn=0.0, signs=None):
        """Drive robots from anywhere until each has bumped once for each turn, and once more.

        **Arguments:**

        - `x`, `y`, `heading`: where the robots start.
        - `turns`: the angle of each turn: of all robots, or of each.
        - `relative`, `absolute`: the bounds of the error of an observed run, as a share of its
            length and in metres.
        - `turn`: the bound of the error of a turn, in radians.
        - `signs`: by what each bound is multiplied, from -1 to 1, for the relative and the absolute
            error of each run and the error of the turn after it, `[bumps, 3, robots]`; or a
            Generator that chooses -1 or 1 for each.
        """
        point = np.stack(np.broadcast_arrays(np.asarray(x, float), y), axis=-1)
        heading = np.broadcast_to(np.asarray(heading, float), len(point)).copy()
        if isinstance(signs, np.random.Generator):
            signs = signs.choice([-1.0, 1.0], (len(turns) + 1, 3, len(point)))
        elif signs is None:
            signs = np.zeros((len(turns) + 1, 3, 1))
        at, rows = self.locate(point), []
        for angle, sign in zip([*turns, 0.0], signs, strict=True):
            length, point, at = self.cast(point, at, heading)
            observed = np.maximum(length * (1 + relative * sign[0]) + absolute * sign[1], 0)
            wall = np.where(at < self.walls, at, INSIDE)
            arc = _dot(point - self.start[wall], self.along[wall])
            rows.append((heading, length, observed, point, wall, np.where(wall < 0, np.nan, arc)))
            heading = heading + angle + turn * sign[2]
        return Runs(*map(np.array, zip(*rows, strict=True)))


def anywhere(free_space, count, rng):
    """Points drawn uniformly from a polygon, or from several."""
    left, bottom, right, top = free_space.bounds
    shapely.prepare(free_space)
    found = np.empty((0, 2))
    while len(found) < count:
        points = rng.uniform((left, bottom), (right, top), (count, 2))
        found = np.concatenate([found, points[shapely.contains_xy(free_space, *points.T)]])
    return found[:count]


def _dot(a, b):
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


EIGHTHS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"The directions of headings that are multiples of 45 degrees."


class ExactRoom:
    """The same for one robot in fractions, with headings that are numbers of directions."""

    def __init__(self, free_space, directions=EIGHTHS):
        self.directions = directions
        rings = rings_of(free_space)
        self.edges = corners_of(
            [[(Fraction(x), Fraction(y)) for x, y in ring.tolist()] for ring in rings]
        )

    def leaves(self, point, u, came=None):
        """Check whether a robot can start from a point; `came` is the direction of its arrival."""
        wedges = [edge for edge in self.edges if edge[1] == point]
        if wedges:
            wedges = [one for one in wedges if came is None or _within(one, _minus(came))]
            return any(_within(one, u) for one in wedges)
        for _, start, end in self.edges:
            along, to = _between(start, end), _between(start, point)
            if _area(along, to) == 0 and 0 < _product(along, to) < _product(along, along):
                return _area(along, u) >= 0
        return True

    def run(self, point, heading, came=None):
        """Drive until the wall: the bump, and how many times the direction it is away."""
        u = self.directions[heading]
        if not self.leaves(point, u, came):
            return point, Fraction(0)
        far = []
        for _, start, end in self.edges:
            along, to = _between(start, end), _between(point, start)
            into = _area(along, u)
            if into < 0:
                distance, arc = Fraction(_area(along, to), into), Fraction(_area(u, to), into)
                if distance > 0 and 0 < arc < 1:
                    far.append(distance)
            if _area(u, to) == 0 and _product(u, to) > 0:
                wedges = [one for one in self.edges if one[1] == start]
                if not any(_within(one, u) and _within(one, _minus(u)) for one in wedges):
                    far.append(Fraction(_product(u, to), _product(u, u)))
        distance = min(far)
        return (point[0] + distance * u[0], point[1] + distance * u[1]), distance

    def drive(self, point, heading, turns):
        """The heading, the length and the bump of each run; turns are numbers of directions.

        A length is a fraction times that of the direction; the fraction is given.
        """
        point, came, found = (Fraction(point[0]), Fraction(point[1])), None, []
        for turn in [*turns, 0]:
            point, distance = self.run(point, heading, came)
            came = self.directions[heading] if distance > 0 else came
            found.append((heading, distance, point))
            heading = (heading + turn) % len(self.directions)
        return found

    def length(self, heading, distance):
        """A length in metres, rounded."""
        return float(distance) * math.hypot(*self.directions[heading])


def _within(edge, u):
    before, corner, after = edge
    opens, closes = _between(corner, after), _between(corner, before)
    left, right = _area(opens, u) >= 0, _area(u, closes) >= 0
    return left and right if _area(opens, closes) > 0 else left or right


def _between(a, b):
    return b[0] - a[0], b[1] - a[1]


def _minus(u):
    return -u[0], -u[1]


def _area(a, b):
    return a[0] * b[1] - a[1] * b[0]


def _product(a, b):
    return a[0] * b[0] + a[1] * b[1]
