import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from ...automata.filter import CONFIRM
from ...robot import CrossLook, camera, pictures
from ...robot.anywhere import run_anywhere
from ...robot.followers import Follower, run_follower
from ...robot.outcome import RunOutcome
from ...robot.patrol import Patrol, run_patrol
from ...robot.plan import run_plan
from ...robot.run_log import LoggedRun, RunLog
from ...robot.tasks.anywhere_task import AnywhereTask
from ...robot.tasks.files import AnyTask, BeliefTask, FilterTask, PlanTask, PolicyTask
from ...robot.tasks.patrol_task import PatrolTask
from ...robot.team import MemberTask, run_member
from ...robot.walker import Walker
from ...study.map_study import cell_at
from .emulation import Emulation, seen_from
from .options import RunOptions
from .outcome import ANYWHERE, confirmed_by


Runner: TypeAlias = tuple[dict[str, Any], Callable[[Walker, RunLog | None], RunOutcome]]


# The kinds of tasks for which options have an effect.
_KINDS = {
    "intruder": ("patrol",),
    "camera": ("patrol",),
    "until": ("filter",),
    "confirm": ("filter", "policy", "belief", "anywhere"),
    "outliers": ("anywhere",),
    "restarts": ("anywhere",),
}


def runner_of(
    task: AnyTask,
    options: RunOptions,
    emulation: Emulation | None,
    direction: int | None,
    before: LoggedRun | None,
) -> Runner:
    """Return the log's header, and a function that runs the task with the robot's controller."""
    header, limit = {**task.header, "direction": direction}, options.limit
    for name, kinds in _KINDS.items():
        if getattr(options, name) not in (None, "known") and task.kind not in kinds:
            raise ValueError(f"--{name}: it has an effect only for a {' or '.join(kinds)}")
    confirm = CONFIRM if options.confirm is None else options.confirm
    if before is not None and "confirm" in before.header:
        confirm = confirmed_by(before)
    match task:
        case FilterTask():
            header |= {"until": options.until}
            follower = functools.partial(task.follower, options.until, confirm=confirm)
            return _followed(header, task.bounces, follower, limit)
        case PolicyTask() | BeliefTask():
            follower = functools.partial(task.follower, confirm=confirm)
            return _followed(header, task.bounces, follower, limit)
        case AnywhereTask():
            if before is not None:
                raise ValueError(
                    "--resume: a robot that starts anywhere cannot resume a run; start another run"
                )
            chosen = {name: getattr(options, name) for name in ANYWHERE}
            chosen = {name: value for name, value in chosen.items() if value is not None}
            anywhere = dataclasses.replace(task.settings, **chosen)
            header |= {name: getattr(anywhere, name) for name in ANYWHERE}
            return header, lambda walker, log: run_anywhere(walker, anywhere, log=log, limit=limit)
        case PlanTask():
            return header, lambda walker, log: run_plan(walker, task.actions, log=log)
        case MemberTask():
            return header, lambda walker, log: run_member(walker, task, log=log)
    if before is not None:
        settings = dict(before.header["patrol"])
    else:
        settings = {
            "start": patrol_start(task, options.start, emulation) % task.cells.positions,
            "facing": direction or 0,
            "seed": options.seed,
            "visits": options.visits,
            "most_bumps": options.bumps,
            "limit": limit,
        }
    patrol = Patrol(task, **settings)
    look: Callable[[int], Any] | None = None
    if options.intruder is not None and emulation is not None:
        look = seen_from(emulation.cells, task, options.intruder)
    elif options.camera is not None:
        look = _cross_look(options.camera)
    header |= {"patrol": patrol.settings}
    return header, lambda walker, log: run_patrol(walker, patrol, look=look, log=log)


def _followed(
    header: dict[str, Any],
    bounces: Sequence[float],
    follower: Callable[[], Follower],
    limit: int,
) -> Runner:
    return header | {"confirm": follower().confirm}, lambda walker, log: run_follower(
        walker, follower(), bounces, log=log, limit=limit
    )


def patrol_start(task: PatrolTask, start: str | None, emulation: Emulation | None = None) -> int:
    """Return the start cell of a patrol, on the map of the patrol.

    `start` is the option `--start`. An emulated robot starts where `emulation` put it.
    """
    if emulation is not None:
        x, y, theta = emulation.cells.centre(emulation.start)
        try:
            return int(task.cells.index(x, y, theta))
        except ValueError as error:
            raise ValueError(f"--start: it is outside the map of {task.path}: {error}") from None
    return task.start if start is None else cell_at(task.cells, start, "--start")


def _cross_look(source: str) -> CrossLook:
    try:
        return CrossLook(camera(int(source)) if source.isdecimal() else pictures(source))
    except (ValueError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"--camera {source}: {reason}") from None
