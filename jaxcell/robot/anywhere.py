import dataclasses
import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from ..base.formatting import counted
from ..walls import (
    Aim,
    Homing,
    RelaxedFilter,
    WallFilter,
    WallSet,
    choose_angles,
    is_localized,
    likeliest,
)
from .outcome import RunOutcome, count_agreed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


@dataclasses.dataclass(frozen=True)
class AnywhereOutcome(RunOutcome):
    """The outcome of a run that started at an unknown pose."""

    place: tuple[float, float] | None = None
    "The centre of the bounding box of the possible places in metres, or `None` if unknown."
    extent: float | None = None
    "The diagonal of the box around the places in metres, or `None` if unknown."
    disbelieved: tuple[int, ...] = ()
    """The bumps, counted from 1, at which the sets first had to disbelieve another bump. That bump,
    which was not on the map, is the same one or an earlier one."""
    refuted: tuple[int, ...] = ()
    "The bumps, counted from 1, whose runs were impossible after the runs before them."


CONFIRM = 20
"""The default number of straight runs that confirm the place of a robot.

Of 3,850 robots on a wrong map, 33 % are known to half a metre at some bump. After 5 more runs 1.4 %
of the robots still agree with the map, after 10 more 0.47 %, and after 20 more 0.08 %.
"""


@dataclasses.dataclass(frozen=True)
class AnywhereSettings:
    """The filter, the bouncing angles and the goal of a robot that starts at an unknown pose."""

    filter: WallFilter
    bounces: tuple[float, ...]
    "The bouncing angles to choose from, in radians, counter-clockwise."
    radius: float
    "The distance in metres within which the robot is localized."
    homing: Homing | None = None
    "The strategy that leads the robot to its goal; `None` if the robot is only localized."
    aim: Aim = "mean"
    """The quantity that the choice of an angle minimizes: the mean or the largest size of the set
    of possible places after the next bumps. It has no effect if there is a goal."""
    ahead: int = 1
    "The number of future bumps that the choice of an angle takes into account."
    seed: int = 0
    "The seed for the random starts in the simulations that compare the angles."
    confirm: int = CONFIRM
    """The number of further straight runs that must not refute the map before the robot is
    localized. The arrival at a goal is not confirmed."""
    outliers: int = 0
    "The number of bumps at things that are not on the map, such as a chair, that sets tolerate."
    restarts: int = 0
    "The number of times that a refuted run begins again from everywhere, while the robot drives."


def run_anywhere(
    walker: Walker, settings: AnywhereSettings, *, log: RunLog | None = None, limit: int = 10_000
) -> AnywhereOutcome:
    """Localize a robot that starts at an unknown pose, or lead it to its goal.

    The robot drives straight until a bump, backs off by `settings.filter.errors.displacement / 2`,
    and turns. The filter uses only the angles of the turns and the lengths of the straight runs.

    **Arguments:** a walker; the filter, the angles and the goal; the log, to which each straight
    run is written immediately; and the largest number of bumps.

    **Returns:** [`AnywhereOutcome`][jaxcell.robot.anywhere.AnywhereOutcome], whose result is
    `"localized"`, `"arrived"` at the goal, `"refuted"` if the lengths of the runs are impossible
    from every start, or `"unfinished"` after `limit` bumps.

    A simulated point robot in an L-shaped room:

        >>> import math
        >>> from jaxcell import robot, space, walls
        >>> from jaxcell.robot.emulation.body import Body
        >>> from jaxcell.robot.emulation.direct import DirectBody
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> errors = walls.Errors(distance=0.05, turn=math.radians(1), displacement=0.06)
        >>> filter = walls.WallFilter.of(room, errors=errors)
        >>> settings = robot.AnywhereSettings(filter, (math.radians(135),), radius=0.5)
        >>> body = Body(room, (1.2, 0.7, 0.4))
        >>> outcome = robot.run_anywhere(robot.Walker(DirectBody(body), 1.0), settings)
        >>> outcome.result, math.dist(outcome.place, body.pose[:2]) < 0.5
        ('localized', True)
    """
    follower = SetFollower(settings)
    errors = settings.filter.errors
    longest = (settings.filter.boundary.diameter + 1) * (1 + errors.run) + errors.distance
    while follower.result is None and follower.bumps < limit:
        run = walker.run_to_wall(longest, errors.displacement / 2)
        follower.observe(run)
        turn = None if follower.result else follower.choose()
        if log is not None:
            log.event(
                "observation",
                observation=1,
                run=run,
                extent=round(follower.extent, 4) if math.isfinite(follower.extent) else None,
                **({"disbelieved": len(follower.disbelieved)} if settings.outliers else {}),
                turn=turn,
                estimate=np.round(walker.estimate, 4).tolist(),
            )
        if turn is not None:
            follower.turn(turn)
            walker.rotate(turn)
    return finished(follower.outcome(), log)


def replay_anywhere(run: LoggedRun, settings: AnywhereSettings) -> AnywhereOutcome:
    """Replay a log of [`run_anywhere`][] through the filter of the robot.

    **Arguments:** the log, and the settings of the run. **Returns:** the outcome of the run so far.

    **Raises:** `ValueError` if a length or an angle in the log is not a number.

    A straight run that is longer than the room:

        >>> from jaxcell import robot, space, walls
        >>> room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
        >>> settings = robot.AnywhereSettings(walls.WallFilter.of(room), (2.0,), radius=0.5)
        >>> events = ({"event": "observation", "observation": 1, "run": 30.0},)
        >>> robot.replay_anywhere(robot.LoggedRun({}, events, True), settings).result
        'refuted'
    """
    follower = SetFollower(settings)
    for _ in follower.follow(run):
        pass
    return follower.outcome()


class SetFollower:
    """The state of a run from an unknown pose: the possible places of the robot on the walls."""

    def __init__(self, settings: AnywhereSettings) -> None:
        self.settings, self._rng = settings, np.random.default_rng(settings.seed)
        self.bumps = 0
        self.result: Literal["localized", "arrived", "refuted"] | None = None
        self.refuted: list[int] = []
        self._begin(settings.filter)

    def _begin(self, filter: WallFilter) -> None:
        """Begin with a robot that has not driven yet, and is followed by a filter."""
        outliers = self.settings.outliers
        self.filter: Any = RelaxedFilter(filter, outliers) if outliers else filter
        self.state: Any = None
        self.extent = math.inf
        self.agreed: int | None = None
        self.disbelieved: list[int] = []

    def observe(self, run: float | None) -> None:
        """Update the possible places after a straight run of `run` metres to a wall.

        `None` means that a run longer than the room met no wall, which refutes the map.
        """
        filter, homing = self.filter, self.settings.homing
        self.bumps += 1
        if run is not None:
            self.state = filter.observe(self.state, max(run, 0.0))
        if run is None or filter.refuted(self.state, 1)[0]:
            self.state, self.extent = None, math.inf
            self._refute()
            return
        extent = filter.extent(self.state, 1)
        self.extent = float(extent[0])
        if self.settings.outliers:
            more = int(filter.disbelieved(self.state, 1)[0]) - len(self.disbelieved)
            self.disbelieved += [self.bumps] * more
        if homing is not None:
            arrived = filter.within(self.state, 1, homing.goal, homing.radius)[0]
            self.result = "arrived" if arrived else None
        else:
            known = bool(is_localized(extent, self.settings.radius)[0])
            self.agreed = count_agreed(self.agreed, known)
            if known and self.agreed is not None and self.agreed >= self.settings.confirm:
                self.result = "localized"

    def _refute(self) -> None:
        """Begin again from everywhere, or end the run if it has done so often enough."""
        self.refuted.append(self.bumps)
        if len(self.refuted) > self.settings.restarts:
            self.result = "refuted"
        else:
            filter = self.settings.filter
            every = np.ones_like(filter.first)
            self._begin(dataclasses.replace(filter, first=every, start=None))

    @property
    def likeliest(self) -> WallSet:
        """The possible places on walls, if the fewest bumps were not on the map."""
        return likeliest(self.state, 1)

    def choose(self) -> float:
        """Choose the angle to turn by at this bump, in radians."""
        filter, bounces = self.settings.filter, self.settings.bounces
        if self.state is None:
            return bounces[int(self._rng.integers(len(bounces)))]
        if self.settings.homing is not None:
            chosen = self.settings.homing.choose(self.likeliest, 1, self._rng)
        else:
            aim, ahead, state = self.settings.aim, self.settings.ahead, self.likeliest
            chosen = choose_angles(filter, state, 1, bounces, self._rng, aim=aim, ahead=ahead)
        return bounces[int(chosen[0])]

    def turn(self, angle: float) -> None:
        """Update the headings at the possible places after a turn by an angle in radians."""
        if self.state is not None:
            self.state = self.filter.turn(self.state, angle)

    def follow(self, run: LoggedRun) -> Iterator[tuple[float | None, float | None]]:
        """Replay a log, and yield the length of the run before each bump and the turn after it.

        The length is `None` if the robot met no wall, and the turn is `None` after the last run.
        When the two numbers are yielded, `state` contains the possible places before the turn.
        Raises `ValueError` if a length or an angle is not a number.
        """
        turn: float | None = 0.0
        for number, event in enumerate(run.events):
            if event["event"] != "observation":
                continue
            if turn is None:
                raise ValueError(
                    f"event {number}: expected no observation after a bump without a turn"
                )
            length, turn = event.get("run"), event.get("turn")
            if length is not None and not (isinstance(length, float | int) and length >= 0):
                raise ValueError(
                    f"event {number}: run: expected a length in metres, got {length!r}"
                )
            if turn is not None and not isinstance(turn, float | int):
                raise ValueError(f"event {number}: turn: expected radians, got {turn!r}")
            self.observe(length)
            yield length, turn
            if turn is not None and self.result != "refuted":
                self.turn(turn)

    def outcome(self) -> AnywhereOutcome:
        """Return the outcome of the run so far."""
        place, where = None, "nowhere" if self.result == "refuted" else "anywhere"
        if math.isfinite(self.extent):
            x, y = (sum(self.filter.box(self.state, 1))[0] / 2).tolist()
            place = (x, y)
            where = f"within {self.extent / 2:.2f} m of ({x:.2f} m, {y:.2f} m)"
        agreed = self.agreed or 0
        known = f"known to be {where} after {self.bumps - agreed} bumps"
        known += f", and {agreed} more agreed" if agreed else ""
        unknown = f"not known after {self.bumps} bumps: {where}"
        if self.agreed is not None:
            unknown = f"not confirmed by {self.settings.confirm} bumps: {known}"
        outliers, again = self.settings.outliers, list(self.refuted)
        if self.result == "refuted":
            again.pop()
        before = self.bumps - 1 - max(again, default=0)
        even = f", even if {outliers} of the bumps were not on the map" if outliers else ""
        refuted = (
            f"the run to bump {self.bumps} is impossible from every place in the room after the "
            f"{before} runs before it{even}: the map is wrong, or the errors of the robot are "
            "larger than their bounds"
        )
        if not self.settings.filter.errors.displacement:
            refuted += (
                ", which have no `displacement`: for a robot with a bumper make the task with "
                "--errors displacement=0.06, or twice the way that it backs off"
            )
        arrived = f"at the goal after {self.bumps} bumps, {where}"
        reasons = {"localized": known, "arrived": arrived, "refuted": refuted, None: unknown}
        reason = reasons[self.result]
        if self.disbelieved:
            were = f"{counted(len(self.disbelieved), 'bump')} not on the map, found at bump "
            reason += f"; disbelieved {were}{', '.join(map(str, self.disbelieved))}"
        if again:
            reason += f"; begun again from everywhere after bump {', '.join(map(str, again))}"
        result, observations = self.result or "unfinished", "1" * self.bumps
        extent = self.extent if math.isfinite(self.extent) else None
        return AnywhereOutcome(
            result,
            observations,
            reason,
            place=place,
            extent=extent,
            disbelieved=tuple(self.disbelieved),
            refuted=tuple(self.refuted),
        )
