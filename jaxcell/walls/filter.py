"""The filter of a robot that starts anywhere, and observes the length of each run to a wall."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Float, Int

from ..base import memory
from ..base.shown import Shown
from ..space import Workspace
from .boundary import Boundary, bump_gains
from .chords import Chords
from .sets import WallSet, arrivals, contains, everywhere, observe, turned
from .start import StartRegion


# The default number of slices of headings.
_SLICES = 360
# The first run is rounded down to one of this many lengths, whose sets are computed once.
_LENGTHS = 16
# The bytes for each chord of a room at the peak of its computation.
_BYTES = 700

_Runs: TypeAlias = Float[np.ndarray, "robots"]
Lengths: TypeAlias = float | npt.ArrayLike


@dataclasses.dataclass(frozen=True)
class Errors:
    """Bounds of the errors of a robot. All bounds are 0 for a robot that moves exactly."""

    run: float = 0.0
    "The largest relative error of the observed length of a run."
    distance: float = 0.0
    "The largest error of the observed length of a run, in metres."
    late: float = 0.0
    """The largest distance, in metres, that is added to a run after the robot has met the wall,
    because it feels the bump late."""
    turn: float = 0.0
    "The largest error of the robot's own turn at a bump, in radians; see `bump_turn`."
    bump_turn: float = 0.0
    """The angle in radians by which a bump at 45 degrees of incidence turns the robot toward the
    wall; see [`jaxcell.space.Slip`][]."""
    heading: float = 0.0
    "The largest error of the heading at the start, in radians."
    displacement: float = 0.0
    "The largest distance from a bump to the start of the next run, in metres."

    def __post_init__(self) -> None:
        for field, limit, expected in (
            ("run", 1.0, "a share below 1, because otherwise any run is possible"),
            ("distance", math.inf, "a finite length in metres"),
            ("late", math.inf, "a finite length in metres"),
            ("turn", math.pi, "less than half a turn, because otherwise all are possible"),
            ("bump_turn", math.pi / 4, "less than 45 degrees"),
            ("heading", math.pi, "less than half a turn; omit the headings if any is possible"),
            ("displacement", math.inf, "a finite length in metres"),
        ):
            value = getattr(self, field)
            if not 0 <= value < limit:
                is_angle = field in ("turn", "bump_turn", "heading")
                got = f"{math.degrees(value):.3g} degrees" if is_angle else f"{value:g}"
                raise ValueError(f"errors: {field}: expected {expected}, got {got}")

    @property
    def keep_headings(self) -> bool:
        """True if headings are exact at the start, and stay exact because no error changes them."""
        return not (self.turn or self.bump_turn or self.heading or self.displacement)

    def bounds(self, least: _Runs, most: _Runs) -> tuple[_Runs, _Runs]:
        """Bound the true lengths of runs observed between `least` and `most`, in metres."""
        low = (least - self.distance - self.late) / (1 + self.run)
        return np.maximum(low, 0.0), (most + self.distance) / (1 - self.run)


@dataclasses.dataclass(frozen=True, eq=False)
class WallFilter(Shown):
    """A filter for robots that start anywhere, run straight until they bump, and turn.

    Its states are sets of places on walls with headings ([`WallSet`][jaxcell.walls.WallSet]). The
    set always contains the true place if the errors are within their bounds and the map is right.
    One `WallSet` contains the sets of many robots. Methods take and return arrays over robots.

    A robot in a room without symmetry turns by 135 degrees at each bump, and measures its runs to
    within a centimetre:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> filter = walls.WallFilter.of(room, headings=8, errors=walls.Errors(distance=0.01))
        >>> place, heading, state = np.array([[1.0, 1.3]]), np.array([0.0]), None
        >>> for bump in range(8):
        ...     wall, arc, run = walls.run_to_wall(filter.boundary, place, heading)
        ...     place, heading = filter.boundary.point(wall, arc), heading + math.radians(135)
        ...     state = filter.observe(state, run)
        ...     state = filter.turn(state, math.radians(135))
        >>> filter.extent(state, 1).round(2).tolist(), place.round(2).tolist()
        ([0.01], [[0.0, 3.3]])
    """

    chords: Chords
    errors: Errors
    first: Bool[np.ndarray, "slices"]
    "True for each slice of headings that a robot may start with."
    step: float
    "The length of the steps that a robot counts, in metres; 0 if it measures its runs."
    start: StartRegion | None = None
    "The region where robots start; `None` for anywhere."

    @classmethod
    def of(
        cls,
        workspace: Workspace,
        *,
        headings: int | None = None,
        slices: int = _SLICES,
        errors: Errors | None = None,
        step: float = 0.0,
        turns: Sequence[float] = (),
        start: StartRegion | None = None,
    ) -> "WallFilter":
        """Build the filter of a room.

        **Arguments:**

        - `workspace`: the room, with the radius of the robot.
        - `headings`: a robot starts with one of the headings `2 pi k / headings`, to within
            `errors.heading`; `None` if its heading is unknown.
        - `slices`: the number of slices of headings, if headings are not known exactly. Twice as
            many slices make sets about half as large, and need four times the memory.
        - `errors`: bounds of the errors of the robot; by default the robot moves exactly.
        - `step`: the length of the steps that the robot counts, in metres; 0 if it measures its
            runs.
        - `turns`: angles by which the robots will turn, in radians. They are checked before the
            chords of the room are computed, which may take minutes.
        - `start`: the region where robots start; by default they start anywhere.

        `headings` and `slices` must be even, `slices` must be at least 4 and a multiple of
        `headings`, and each angle must be a multiple of the width of a slice.
        """
        errors = errors or Errors()
        if not 0 <= step < math.inf:
            raise ValueError(f"step: expected a length in metres from 0, got {step:g}")
        for name, number, least in (("headings", headings, 2), ("slices", slices, 4)):
            if number is not None and (number < least or number % 2):
                raise ValueError(f"{name}: expected an even number from {least}, got {number}")
        known = headings is not None and errors.keep_headings
        if headings is not None and known:
            slices = headings
        elif headings is not None and slices % headings:
            raise ValueError(f"slices: expected a multiple of {headings} headings, got {slices}")
        if start is not None:
            start.check(workspace)
        _in_slices(np.asarray(turns, float), slices, "" if known else "; set other `slices`")
        boundary = Boundary.of(workspace)
        walls = len(boundary.length)
        needed = _BYTES * slices * walls * (4 if known else 40)
        memory.check(needed, f"a map of {walls} walls and {slices} headings", "use fewer slices")
        if errors.distance > boundary.diameter:
            raise ValueError(
                f"errors: distance: expected at most {boundary.diameter:.3g} m, the diameter of "
                f"the room, got {errors.distance:g} m: no two runs would differ"
            )
        chords = Chords.of(boundary, slices, known=known, displacement=errors.displacement)
        first = np.ones(slices, bool)
        if headings is not None and not known:
            width = 2 * math.pi / slices
            # A heading at the edge of two slices may be in either slice.
            off = np.arange(slices) - np.round(np.arange(slices) * headings / slices) * (
                slices // headings
            )
            reach = errors.heading / width
            first = (off + 1 >= -reach - 1e-9) & (off <= reach + 1e-9)
        if start is not None:
            first &= start.faced(slices, chords.width, errors.heading)
            if not first.any():
                raise ValueError("start: expected one of the headings, or `headings` None")
        return cls(chords, errors, first, step, start)

    @property
    def boundary(self) -> Boundary:
        """The walls of the room."""
        return self.chords.boundary

    def observe(self, state: WallSet | None, run: Lengths) -> WallSet:
        """Update the sets with the length of the run of each robot to a wall, in metres.

        If robots count steps, a run may be up to one step longer than the counted steps. The state
        `None` stands for robots that have not driven yet. The set of a robot is empty if its runs
        are impossible from every place.
        """
        low, high = self.lengths(run)
        if state is not None:
            return observe(self.chords, state, low, high)
        if self.start is not None:
            copies = np.repeat(np.arange(low.size), self._departures.robot.size)
            parts = [np.tile(part, low.size) for part in self._departures[1:]]
            return self.start.reached(self.chords, WallSet(copies, *parts), low, high)
        level = np.floor(low * _LENGTHS / self.boundary.diameter).astype(int)
        longer = low > self.boundary.diameter + self.chords.reach.max()
        level = np.where(longer, _LENGTHS + 1, np.minimum(level, _LENGTHS))
        starts = [self._after_first_run(k) for k in level.tolist()]
        count = [len(start.wall) for start in starts]
        parts = [np.concatenate([start[i] for start in starts]) for i in range(1, 5)]
        return WallSet(np.repeat(np.arange(len(starts)), count), *parts)

    def lengths(self, run: Lengths) -> tuple[_Runs, _Runs]:
        """Bound the true lengths of observed runs, in metres."""
        least = np.atleast_1d(np.asarray(run, float))
        if not (np.isfinite(least) & (least >= 0)).all():
            raise ValueError("run: expected finite lengths in metres, from 0")
        most = least
        if self.step:
            least = np.floor((least + self.boundary.tolerance) / self.step) * self.step
            most = least + self.step
        return self.errors.bounds(least, most)

    def turn(self, state: WallSet, angle: Lengths) -> WallSet:
        """Turn each robot left by an angle in radians, a multiple of the width of a slice."""
        slices = self.chords.slices
        shift = _in_slices(angle, slices)
        each = shift[state.robot] if shift.ndim else np.full(state.robot.size, shift)
        errors, width = self.errors, 2 * math.pi / slices
        # Within a slice and an arc, the turn by a bump differs from that at an edge by at most
        # `bump_turn` times their angles. If a heading grazes the wall, so does an edge.
        bend = 2 * self.boundary.bend[state.wall]
        gains = [
            bump_gains(
                self.boundary, state.wall, (state.slice + edge) * width + side, errors.bump_turn
            )
            for edge, side in ((0, -bend / 2), (1, bend / 2))
        ]
        slack = errors.turn + errors.bump_turn * (width + bend)
        first = np.floor((np.min(gains, axis=(0, 1)) - slack) / width + 1e-9).astype(int)
        last = np.ceil((np.max(gains, axis=(0, 1)) + slack) / width - 1e-9).astype(int)
        return turned(state, each + first, last - first + 1, slices)

    def extent(self, state: WallSet, robots: int) -> Float[np.ndarray, "robots"]:
        """Compute the diagonal of the box around the places of each robot, in metres.

        The extent of an empty set is infinite, because nothing is known about a lost robot.
        """
        low, high = self.box(state, robots)
        return np.linalg.norm(np.where(high >= low, high - low, np.inf), axis=1)

    def box(
        self, state: WallSet, robots: int
    ) -> tuple[Float[np.ndarray, "robots 2"], Float[np.ndarray, "robots 2"]]:
        """Compute the lower left and the upper right corner of the box around each set, in metres.

        The box of an empty set is empty: its lower left corner is infinite, the other one minus
        infinite.
        """
        low, high = np.full((robots, 2), np.inf), np.full((robots, 2), -np.inf)
        first = np.flatnonzero(np.diff(state.robot, prepend=-1))
        if first.size:
            ends = [self.boundary.point(state.wall, arc) for arc in (state.begin, state.end)]
            robot = state.robot[first]
            low[robot] = np.minimum.reduceat(np.minimum(*ends), first)
            high[robot] = np.maximum.reduceat(np.maximum(*ends), first)
        return low, high

    def contains(
        self,
        state: WallSet,
        slices: Int[np.ndarray, "robots"],
        place: Float[np.ndarray, "robots 2"],
    ) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether its set contains its place with its slice of headings."""
        return contains(self.boundary, state, slices, place)

    def within(
        self, state: WallSet, robots: int, centre: tuple[float, float], radius: float
    ) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether its set is not empty and lies wholly in a disc."""
        ends = [self.boundary.point(state.wall, arc) for arc in (state.begin, state.end)]
        outside = np.max([np.hypot(*(end - centre).T) for end in ends], axis=0) > radius
        leaves = np.bincount(state.robot[outside], minlength=robots) > 0
        return ~leaves & ~self.refuted(state, robots)

    def refuted(self, state: WallSet, robots: int) -> Bool[np.ndarray, "robots"]:
        """Check for each robot whether its set is empty, so that no place explains its runs."""
        return np.bincount(state.robot, minlength=robots) == 0

    def slice_of(self, heading: Lengths) -> Int[np.ndarray, "headings"]:
        """Find the slice of each heading in radians, or the nearest slice if headings are known."""
        place = np.asarray(heading) * self.chords.slices / (2 * math.pi)
        whole = np.floor(place) if self.chords.width else np.round(place)
        return whole.astype(int) % self.chords.slices

    @functools.cached_property
    def _arrivals(self) -> dict[int, WallSet]:
        return {}

    @functools.cached_property
    def _departures(self) -> WallSet:
        """The set of one robot after a run of any length from the region `start`."""
        assert self.start is not None
        places = everywhere(self.chords)
        least, most = np.zeros(1), np.full(1, self.boundary.diameter + self.chords.reach.max())
        return self.start.reached(self.chords, places.take(self.first[places.slice]), least, most)

    def _after_first_run(self, level: int) -> WallSet:
        if level not in self._arrivals:
            least = np.array([level * self.boundary.diameter / _LENGTHS])
            places = arrivals(self.chords, everywhere(self.chords), least)
            possible = self.first[places.slice] & (level <= _LENGTHS)
            self._arrivals[level] = places.take(possible)
        return self._arrivals[level]


def is_localized(extent: Float[np.ndarray, "*shape"], radius: float) -> Bool[np.ndarray, "*shape"]:
    """Check whether robots are localized to within `radius` metres.

    A robot is localized if the extent of its set, in metres, is at most twice the radius. The
    extent of an empty set is infinite, so that a lost robot is never localized.
    """
    return extent <= 2 * radius


def bumps_until_localized(
    extent: Float[np.ndarray, "robots bumps"], radius: float
) -> Float[np.ndarray, "robots"]:
    """Find the first bump, counted from 1, after which each robot is localized; `inf` if none.

    `extent` contains the extent of each set after each bump, in metres.

        >>> import numpy as np
        >>> from jaxcell import walls
        >>> walls.bumps_until_localized(np.array([[9.0, 0.8, 2.0], [9.0, 3.0, np.inf]]), 0.5)
        array([ 2., inf])
    """
    localized = is_localized(extent, radius)
    return np.where(localized.any(axis=1), localized.argmax(axis=1) + 1.0, np.inf)


def _in_slices(angle: Lengths, slices: int, remedy: str = "") -> Int[np.ndarray, "*robots"]:
    """Express angles in radians by whole numbers of slices; raise if an angle has none."""
    exact = np.asarray(angle) * slices / (2 * math.pi)
    shift = np.asarray(np.round(exact), int)
    wrong = np.atleast_1d(np.abs(exact - shift) > 1e-6)
    if wrong.any():
        degrees = math.degrees(np.atleast_1d(angle)[wrong][0])
        raise ValueError(
            f"angle: expected a multiple of {360 / slices:g} degrees, the width of a slice of "
            f"headings, got {degrees:g} degrees{remedy}"
        )
    return shift
