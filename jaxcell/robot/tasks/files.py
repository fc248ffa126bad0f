import dataclasses
import math
import os
from pathlib import Path
from typing import Any

from ...automata import Belief, Filter, HiddenMap, Policy
from ...automata.filter import CONFIRM
from ...automata.formats.storage import read_kind
from ...base.documents import Fields, about, decode_json, read_text
from ...base.results import check_result
from ...space.cells import MAX_CELLS
from ..followers import BeliefFollower, FilterFollower, Follower, PolicyFollower, Until
from ..team import MemberTask, read_member
from .anywhere_task import AnywhereTask, read_anywhere
from .patrol_task import PatrolTask, read_patrol
from .task import VERSION, Task, angles, common_fields


@dataclasses.dataclass(frozen=True)
class FilterTask(Task):
    """The task of a robot that runs a localization filter."""

    kind = "filter"
    filter: Filter
    bounce: float
    "The bouncing angle of the filter, in radians."

    @property
    def bounces(self) -> tuple[float, ...]:
        return (self.bounce,)

    @property
    def header(self) -> dict[str, Any]:
        return {**super().header, "bounce_deg": math.degrees(self.bounce)}

    def follower(self, until: Until = "known", *, confirm: int = CONFIRM) -> Follower:
        """Create the state of the filter at the start of a run."""
        return FilterFollower(self.filter, until, confirm=confirm)


@dataclasses.dataclass(frozen=True)
class _Choice(Task):
    bounces: tuple[float, ...]
    "The bouncing angles to choose from, in radians."

    @property
    def header(self) -> dict[str, Any]:
        return {**super().header, "bounce_deg": [*map(math.degrees, self.bounces)]}


@dataclasses.dataclass(frozen=True)
class PolicyTask(_Choice):
    """The task of a robot that runs a localization policy."""

    kind = "policy"
    policy: Policy

    def follower(self, *, confirm: int = CONFIRM) -> Follower:
        """Create the state of the policy at the start of a run."""
        return PolicyFollower(self.policy, confirm=confirm)


@dataclasses.dataclass(frozen=True)
class BeliefTask(_Choice):
    """The task of a slipping robot that is localized with a belief."""

    kind = "belief"
    belief: Belief

    def follower(self, *, confirm: int = CONFIRM) -> Follower:
        """Create the state of the belief at the start of a run."""
        return BeliefFollower(self.belief, confirm=confirm)


@dataclasses.dataclass(frozen=True)
class PlanTask(Task):
    """The task of a robot that follows a navigation plan."""

    kind = "plan"
    start: int
    "The cell where the plan starts."
    actions: tuple[float, ...]
    "The actions: 0 for a step without a bump, otherwise the turn after a bump, in radians."
    positions: int | None = None
    "The number of positions of the map, or `None` if the file does not contain it."

    @property
    def start_direction(self) -> int | None:
        return None if self.positions is None else self.start // self.positions

    @property
    def header(self) -> dict[str, Any]:
        return {**super().header, "start": self.start, "actions": self.actions}


def other_rooms(task: FilterTask | PolicyTask, confirm: int) -> dict[str, float | int | None]:
    """Return the share of robots in random other rooms that are localized as surely.

    `confirm` is the number of further observations that confirm the place of a robot. **Returns:**
    the `other_room_share` and, in `other_rooms`, the number of rooms; `None` for what the file of
    the task does not contain.
    """
    source = task.policy if isinstance(task, PolicyTask) else task.filter
    shares = source.metadata.get("other_room_shares")
    shares = shares if isinstance(shares, dict) else {}
    enough = [least for least in map(int, shares) if least <= confirm]
    return {
        "other_room_share": float(shares[str(max(enough))]) if enough else None,
        "other_rooms": source.metadata.get("other_rooms"),
    }


AnyTask = FilterTask | PolicyTask | BeliefTask | PlanTask | MemberTask | PatrolTask | AnywhereTask
"""Any task that [`load_task`][] returns."""


def load_task(path: str | os.PathLike[str], robot: int | None = None) -> AnyTask:
    """Read the task of a robot.

    **Arguments:**

    - `path`: a file that a command of `jaxcell` wrote with `--out`: `filter.jxf`, `policy.jxf` or
        `belief.jxb` (`localize slip`), `anywhere.json` (`localize anywhere`, `navigate anywhere`),
        `summary.json` (`navigate`), `team.json` (`team`), or `patrol.json` (`patrol map`).
    - `robot`: the number of the robot in a team or patrol, by default the first robot.

    **Returns:** the task.

    **Raises:** `ValueError`, with the file and the field, if the file contains no task or plan, or
    no robot with this number; `FileNotFoundError` if there is no file.

    The task of the only robot of a team:

        >>> import math
        >>> from jaxcell import examples, robot
        >>> common = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.0}
        >>> path = examples.folder() / "team.json"
        >>> robot.save_team(path, common, [(0.5, 0.5, 0.0)], [math.pi / 2], ["001"])
        >>> task = robot.load_task(path)
        >>> type(task).__name__, task.robots
        ('MemberTask', 1)
    """
    path = Path(path)
    check_result(path)
    if path.suffix == ".nc":
        raise ValueError(
            f"{path}: a robot does not read NetCDF; expected filter.jxf, team.json, patrol.json or "
            "the summary.json of a plan. To get a single plan of all plans between cells, run "
            "`jaxcell navigate --start ... --goal ... --out`"
        )
    values = _json(path) if path.suffix == ".json" else {}
    kind = None
    if values.get("format") == "jaxcell-robot-task":
        Fields(values, f"{path}: ").check_version(VERSION)
        kind = values.get("kind")
    if kind == MemberTask.kind:
        return read_member(path, values, robot or 0)
    if kind == PatrolTask.kind:
        return read_patrol(path, values, robot or 0)
    if kind == AnywhereTask.kind:
        return read_anywhere(path, values)
    if values.get("kind") == "rounds":
        raise ValueError(
            f"{path}: it has routes on a graph; a robot drives on the cells of a map, as in the "
            "round.json of `jaxcell patrol map --out`"
        )
    if robot is not None:
        raise ValueError(f"{path}: the task is for one robot, and has no robot {robot}")
    if path.suffix == ".json":
        return _plan(path, Fields(values, f"{path}: "))
    if path.suffix == ".jxb":
        hidden = HiddenMap.load(path)
        fields = Fields(hidden.metadata, f"{path}: ")
        common = common_fields(path, fields) | {"belief": Belief(hidden)}
        bounces = angles(path, fields, "bounce_deg", "localize slip", hidden.angles)
        return BeliefTask(**common, bounces=bounces)
    if read_kind(path) == "policy":
        return _policy(path)
    filter = Filter.load(path)
    fields = Fields(filter.metadata, f"{path}: ")
    bounce, *_ = angles(path, fields, "bounce_deg", "localize", 1)
    return FilterTask(**common_fields(path, fields), filter=filter, bounce=bounce)


def _policy(path: Path) -> PolicyTask:
    policy = Policy.load(path)
    fields = Fields(policy.metadata, f"{path}: ")
    onward = 0 if policy.onward is None else policy.onward.turn
    count = 1 + max(int(policy.turn.max()), onward)
    bounces = angles(path, fields, "bounce_deg", "localize", count)
    return PolicyTask(**common_fields(path, fields), policy=policy, bounces=bounces)


def _plan(path: Path, fields: Fields) -> PlanTask:
    fields.check_version(VERSION)
    if fields.get("found") is False:
        raise ValueError(f"{path}: found: there is no path to the goal, so no plan to run")
    actions = angles(path, fields, "actions_deg", "navigate", 0)
    common, positions, last = common_fields(path, fields), None, MAX_CELLS - 1
    if fields.get("positions") is not None:
        positions = fields.whole("positions", 1, MAX_CELLS)
        last = min(last, positions * common["directions"] - 1)
    start = fields.whole("start", 0, last)
    return PlanTask(**common, start=start, actions=actions, positions=positions)


def _json(path: Path) -> dict[str, Any]:
    with about(path):
        values = decode_json(read_text(path), "a task")
    return values if isinstance(values, dict) else {}
