"""Sets that hold a robot although some of its bumps were at things that are not on the map."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from ..space.copies import copies
from .filter import Lengths, WallFilter
from .sets import WallSet, arrivals, everywhere, leaving, observe
from .start import at_distance


# The largest length in metres of the pieces of walls whose runs end in one disc.
_PIECE = 0.1


class Discs(NamedTuple):
    """Discs in the free space in which robots may have stopped, each with a slice of headings."""

    robot: Int[np.ndarray, "discs"]
    slice: Int[np.ndarray, "discs"]
    place: Float[np.ndarray, "discs 2"]
    "The centre of each disc, in metres."
    radius: Float[np.ndarray, "discs"]


class RelaxedSet(NamedTuple):
    """The possible places of robots, by the number of bumps that were not on the map.

    `walls[k]` and `discs[k]` contain the places of robots for which `k` bumps were not on the map:
    the last bump was at a wall, or inside the room. If `bumps` is `k`, a robot for which no bump
    was on the map may be anywhere.
    """

    bumps: int
    walls: tuple[WallSet, ...]
    discs: tuple[Discs, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class RelaxedFilter(Shown):
    """A filter whose sets hold robots although up to `outliers` bumps were not on the map.

    A bump at a chair or a foot is at no wall of the map: the robot has stopped inside the room, as
    far along its run as it measured. The filter follows, for each number of such bumps, the robots
    with the last bump at a wall, as `filter` does, and those that stopped inside. Methods take and
    return arrays over robots, as those of [`WallFilter`][jaxcell.walls.WallFilter].

    A robot from (1, 1) is to drive 4 m to the wall, but stops after 2.5 m, turns by 90 degrees and
    meets the upper wall after 1 m:

        >>> import math
        >>> from jaxcell import space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> dock = walls.StartRegion((1.0, 1.0), heading=0.0)
        >>> errors = walls.Errors(distance=0.01)
        >>> filter = walls.WallFilter.of(room, headings=8, errors=errors, start=dock)
        >>> relaxed = walls.RelaxedFilter(filter, outliers=1)
        >>> state = relaxed.turn(relaxed.observe(None, [2.5]), math.radians(90))
        >>> state = relaxed.observe(state, [1.0])
        >>> relaxed.disbelieved(state, 1).tolist()
        [1]
    """

    filter: WallFilter
    outliers: int
    "The largest number of bumps that were not on the map."

    def __post_init__(self) -> None:
        if self.outliers < 1:
            raise ValueError(f"outliers: expected at least 1, got {self.outliers}")

    def observe(self, state: RelaxedSet | None, run: Lengths) -> RelaxedSet:
        """Update the sets with the length of the run of each robot to a bump, in metres.

        The state `None` stands for robots that have not driven yet.
        """
        filter, levels = self.filter, self.outliers + 1
        low, high = filter.lengths(run)
        bumps = 0 if state is None else state.bumps
        start = self._start(low.size) if state is None else None
        walls, discs = [], []
        for level in range(levels):
            nowhere, no_discs = _nothing()
            on, inside = [nowhere], [no_discs]
            if state is not None:
                on += [observe(filter.chords, state.walls[level], low, high)]
                on += [self._to_walls(state.discs[level], low, high)]
            if level == bumps and (filter.start is None or not level):
                on += [self._first(level, run, low)]
            if level and state is not None:
                inside += [self._stopped(state.walls[level - 1], low, high)]
                inside += [self._moved(state.discs[level - 1], low, high)]
            if level == 1 and start is not None:
                inside += [self._moved(start, low, high)]
            joined = [np.concatenate(part) for part in zip(*on, strict=True)]
            walls.append(WallSet(*joined).joined())
            discs.append(Discs(*map(np.concatenate, zip(*inside, strict=True))))
        return RelaxedSet(bumps + 1, tuple(walls), tuple(discs))

    def turn(self, state: RelaxedSet, angle: Lengths) -> RelaxedSet:
        """Turn each robot left by an angle in radians, a multiple of the width of a slice.

        Nothing is known about a thing that is not on the map, so a bump at it turns the robot to
        either side by up to `bump_turn`.
        """
        filter = self.filter
        slices, errors = filter.chords.slices, filter.errors
        walls = tuple(filter.turn(part, angle) for part in state.walls)
        width = 2 * np.pi / slices
        spread = int(np.ceil((errors.turn + errors.bump_turn) / width - 1e-9))
        discs = []
        for part in state.discs:
            shift = np.round(np.asarray(angle) / width).astype(int)
            each = shift[part.robot] if shift.ndim else shift
            copy, number = copies(np.full(part.robot.size, 2 * spread + 1))
            slice_ = ((part.slice + each)[copy] + number - spread) % slices
            discs.append(Discs(part.robot[copy], slice_, part.place[copy], part.radius[copy]))
        return RelaxedSet(state.bumps, walls, tuple(discs))

    def extent(self, state: RelaxedSet, robots: int) -> Float[np.ndarray, "robots"]:
        """Compute the diagonal of the box around the places of each robot, in metres.

        The extent is infinite for an empty set, and while no bump needs to have been on the map.
        """
        low, high = self.box(state, robots)
        return np.linalg.norm(np.where(high >= low, high - low, np.inf), axis=1)

    def box(
        self, state: RelaxedSet, robots: int
    ) -> tuple[Float[np.ndarray, "robots 2"], Float[np.ndarray, "robots 2"]]:
        """Compute two corners of the box around each set, as `WallFilter.box` does."""
        boxes = [self.filter.box(walls, robots) for walls in state.walls]
        low, high = np.min([low for low, _ in boxes], 0), np.max([high for _, high in boxes], 0)
        for discs in state.discs:
            np.minimum.at(low, discs.robot, discs.place - discs.radius[:, None])
            np.maximum.at(high, discs.robot, discs.place + discs.radius[:, None])
        if self._anywhere(state):
            return np.full_like(low, -np.inf), np.full_like(high, np.inf)
        return low, high

    def within(
        self, state: RelaxedSet, robots: int, centre: tuple[float, float], radius: float
    ) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether its set is not empty and lies wholly in a disc."""
        leaves = np.full(robots, self._anywhere(state))
        for walls, discs in zip(state.walls, state.discs, strict=True):
            inside = self.filter.within(walls, robots, centre, radius)
            leaves |= ~inside & ~self.filter.refuted(walls, robots)
            outside = np.hypot(*(discs.place - centre).T) + discs.radius > radius
            leaves[discs.robot[outside]] = True
        return ~leaves & ~self.refuted(state, robots)

    def refuted(self, state: RelaxedSet, robots: int) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether more bumps were not on the map than `outliers`."""
        return self.disbelieved(state, robots) > self.outliers

    def disbelieved(self, state: RelaxedSet, robots: int) -> Int[np.ndarray, "robots"]:
        """Count the fewest bumps of each robot that were not on the map.

        The number is `outliers + 1` for an empty set: more bumps were not on the map.
        """
        fewest = _fewest(state, robots)
        return np.minimum(fewest, state.bumps) if self._anywhere(state) else fewest

    def contains(
        self,
        state: RelaxedSet,
        slices: Int[np.ndarray, "robots"],
        place: Float[np.ndarray, "robots 2"],
    ) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether its set contains its place with its slice of headings."""
        inside = np.full(len(place), self._anywhere(state))
        for walls, discs in zip(state.walls, state.discs, strict=True):
            inside |= self.filter.contains(walls, slices, place)
            apart = np.hypot(*(place[discs.robot] - discs.place).T)
            held = (discs.slice == slices[discs.robot]) & (apart <= discs.radius)
            inside[discs.robot[held]] = True
        return inside

    def _anywhere(self, state: RelaxedSet) -> bool:
        """Return whether robots may be anywhere, because no bump needs to have been on the map."""
        return self.filter.start is None and state.bumps <= self.outliers

    @functools.cached_property
    def _tree(self) -> shapely.STRtree:
        """The tree that finds the walls in a square."""
        boundary = self.filter.boundary
        wall = np.arange(boundary.length.size)
        ends = [boundary.point(wall, arc) for arc in (0.0 * boundary.length, boundary.length)]
        return shapely.STRtree(shapely.linestrings(np.stack(ends, axis=1)))

    def _start(self, robots: int) -> Discs | None:
        """Return the start region as discs; `None` if robots start anywhere."""
        region = self.filter.start
        if region is None:
            return None
        slices = np.flatnonzero(self.filter.first)
        robot, slice_ = np.repeat(np.arange(robots), slices.size), np.tile(slices, robots)
        place, radius = np.tile(region.place, (robot.size, 1)), np.full(robot.size, region.radius)
        return Discs(robot, slice_, place, radius)

    def _first(self, level: int, run: Lengths, low: Float[np.ndarray, "robots"]) -> WallSet:
        """Return the sets after the first bump on the map, if `level` bumps before it were not."""
        if not level:
            return self.filter.observe(None, run)
        chords = self.filter.chords
        starts = [arrivals(chords, everywhere(chords), least[None]) for least in low]
        parts = [np.concatenate([start[i] for start in starts]) for i in range(1, 5)]
        return WallSet(np.repeat(np.arange(low.size), [s.wall.size for s in starts]), *parts)

    def _stopped(
        self, state: WallSet, low: Float[np.ndarray, "robots"], high: Float[np.ndarray, "robots"]
    ) -> Discs:
        """Find the discs in which robots stop that run `low` to `high` metres from walls."""
        chords = self.filter.chords
        boundary = chords.boundary
        longest = np.full(low.size, boundary.diameter + chords.reach.max())
        robot, row, begin, end = leaving(chords, state, low, longest)
        left = WallSet(robot, chords.slice[row], chords.wall[row], begin, end).joined()
        parts = np.maximum(1, np.ceil((left.end - left.begin) / _PIECE)).astype(int)
        source, number = copies(parts)
        size = ((left.end - left.begin) / parts)[source]
        wall = left.wall[source]
        place = boundary.point(wall, left.begin[source] + (number + 0.5) * size)
        radius = size / 2 + chords.displacement + boundary.bulge[wall] + 10 * boundary.tolerance
        return self._moved(Discs(left.robot[source], left.slice[source], place, radius), low, high)

    def _moved(
        self, discs: Discs, low: Float[np.ndarray, "robots"], high: Float[np.ndarray, "robots"]
    ) -> Discs:
        """Move discs of robots that run straight for `low` to `high` metres."""
        chords, robot = self.filter.chords, discs.robot
        high = np.minimum(high, chords.boundary.diameter + chords.reach.max())
        middle = discs.slice * (2 * np.pi / chords.slices) + chords.width / 2
        ahead = np.stack([np.cos(middle), np.sin(middle)], axis=1)
        run, off = (low + high)[robot] / 2, np.maximum(high - low, 0.0)[robot] / 2
        radius = discs.radius + off + run * chords.width / 2 + chords.displacement
        place = discs.place + run[:, None] * ahead
        return Discs(robot, discs.slice, place, radius + 10 * chords.boundary.tolerance)

    def _to_walls(
        self, discs: Discs, low: Float[np.ndarray, "robots"], high: Float[np.ndarray, "robots"]
    ) -> WallSet:
        """Find the places at walls that runs of `low` to `high` metres from discs lead to."""
        chords, ends = self.filter.chords, self._moved(discs, low, high)
        # The ends of the runs, between two rays and two lines, lie in a square around their disc.
        side = 2 * (ends.radius + chords.boundary.bulge.max()) / np.cos(chords.width / 2)
        squares = shapely.box(*(ends.place - side[:, None]).T, *(ends.place + side[:, None]).T)
        disc, wall = self._tree.query(squares)
        length = chords.boundary.length[wall]
        whole = WallSet(disc, discs.slice[disc], wall, np.zeros(wall.size), length)
        least, most = low[discs.robot], high[discs.robot]
        ahead = at_distance(chords, whole, discs.place, discs.radius, least, most)
        reached = arrivals(chords, ahead, least)
        return reached._replace(robot=discs.robot[reached.robot])


def likeliest(state: WallSet | RelaxedSet, robots: int) -> WallSet:
    """Return the places on walls of each robot if the fewest bumps were not on the map."""
    if isinstance(state, WallSet):
        return state
    fewest = _fewest(state, robots)
    kept = [part.take(fewest[part.robot] == level) for level, part in enumerate(state.walls)]
    return WallSet(*map(np.concatenate, zip(*kept, strict=True))).joined()


def _fewest(state: RelaxedSet, robots: int) -> Int[np.ndarray, "robots"]:
    """Find the least level with a place of each robot; the number of levels if no level has one."""
    levels = len(state.walls)
    fewest = np.full(robots, levels)
    for level in reversed(range(levels)):
        fewest[state.walls[level].robot] = level
        fewest[state.discs[level].robot] = level
    return fewest


def _nothing() -> tuple[WallSet, Discs]:
    """Return a set and discs of no robot, to which others are joined."""
    none, no_length = np.zeros(0, int), np.zeros(0)
    no_discs = Discs(none, none, np.zeros((0, 2)), no_length)
    return WallSet(none, none, none, no_length, no_length), no_discs
