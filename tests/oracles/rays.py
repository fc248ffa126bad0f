"""A robot that drives straight until the wall and turns there, from anywhere in a room.

`drive` follows many robots by the rays of an experiment, and `ExactRoom` one robot in fractions.
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

from experiments.chapter_2.straight_runs import Rays, anywhere as anywhere


INSIDE = -1
"The place of a robot that is not at a wall."


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


def drive(free_space, point, heading, turns, *, relative=0.0, absolute=0.0, turn=0.0, signs=None):
    """Drive robots from anywhere until each has bumped once for each turn, and once more.

    **Arguments:**

    - `point`, `heading`: the starts of the robots, inside the room.
    - `turns`: the angle of each turn: of all robots, or of each.
    - `relative`, `absolute`: the bounds of the error of an observed run, as a share of its
        length and in metres.
    - `turn`: the bound of the error of a turn, in radians.
    - `signs`: by what each bound is multiplied, from -1 to 1, for the relative and the absolute
        error of each run and the error of the turn after it, `[bumps, 3, robots]`; or a
        Generator that chooses -1 or 1 for each.
    """
    if isinstance(signs, np.random.Generator):
        signs = signs.choice([-1.0, 1.0], (len(turns) + 1, 3, len(point)))
    elif signs is None:
        signs = np.zeros((len(turns) + 1, 3, 1))
    room, at, rows = Rays(free_space), np.full(len(point), INSIDE), []
    for angle, sign in zip([*turns, 0.0], signs, strict=True):
        length, point, at = room.run(point, at, heading)
        observed = np.maximum(length * (1 + relative * sign[0]) + absolute * sign[1], 0)
        wall = np.where(at < room.walls, at, INSIDE)
        arc = ((point - room.start[wall]) * room.along[wall]).sum(axis=1)
        rows.append((heading, length, observed, point, wall, np.where(wall < 0, np.nan, arc)))
        heading = heading + angle + turn * sign[2]
    return Runs(*map(np.array, zip(*rows, strict=True)))


def rings_of(free_space):
    """The rings of a polygon or of several; the free space lies to the left of each."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(free_space)))
    return [shapely.get_coordinates(ring)[:-1] for ring in rings]


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
