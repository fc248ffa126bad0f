"""One member of a sweep in detail: what the command of its task writes for its parameters."""

import dataclasses
import math
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tyro

from ..study import Study
from ..sweep.work import study_of
from .groups import Groups
from .localize import Localize
from .navigate import Navigate
from .options import OutputOptions, command_name
from .patrol_graph import PatrolGraph
from .terminal import status, table, telling


# The command of a task, whose options are the parameters of the task, and its recording.
_COMMANDS: dict[str, tuple[type[OutputOptions], str]] = {
    "groups": (Groups, "groups.rrd"),
    "localize": (Localize, "localization.rrd"),
    "plans": (Navigate, "navigation.rrd"),
    "patrol": (PatrolGraph, "patrol.rrd"),
}


# So many columns of the costs between all cells are held at a time.
_GOALS = 256


def check_detail(task: str) -> None:
    """Raises `ValueError` if members of a task have no detail to show."""
    if task != "rooms" and task not in _COMMANDS and study_of(task) is None:
        raise ValueError(
            f"--select: the task {task!r} has no detail to show; those that have are "
            f"{', '.join(sorted([*_COMMANDS, 'cover', 'drift', 'rooms']))}"
        )


def member_detail(task: str, parameters: Mapping[str, Any], seed: int, out: Path) -> dict[str, Any]:
    """Computes a member again, prints what is found, and writes its recording.

    That of the task `plans`, which is about all pairs of cells, has the costliest plan.

    **Arguments:**

    - `task`: the name of a built-in task.
    - `parameters`: those of the member.
    - `seed`: of the sweep.
    - `out`: the recording, whose folder exists.

    **Returns:** the summary that the command prints as JSON.

    **Raises:** `ValueError` if the task has no detail, or none with one of the parameters.
    """
    check_detail(task)
    if (study := study_of(task)) is not None:
        return _study(study, parameters, seed, out)
    if task == "rooms":
        return _room(parameters, seed, out)
    command, recording = _COMMANDS[task]
    if task == "plans":
        parameters = {**parameters, **_costliest(parameters)}
    kept: dict[str, Any] = {}

    def finish(self: Any, summary: dict[str, Any], show: Callable[[], None], *_: Any) -> int:
        kept.update(summary)
        show()
        return 0

    # Where this one writes is gone a moment later, so it is not to say so.
    quiet = type(command.__name__, (command,), {"finish": finish})
    with tempfile.TemporaryDirectory(prefix=".member-", dir=out.parent) as folder:
        _command(quiet, task, {**parameters, "out": folder}).run()
        os.replace(Path(folder) / recording, out)
    return kept


def _study(
    study: type[Study], parameters: Mapping[str, Any], seed: int, out: Path
) -> dict[str, Any]:
    """The answer of a study, its tables, and its recording."""
    from .. import record
    from ..runtime import configure_jax
    from ..sweep.studies import studies
    from .tables import show

    configure_jax()
    (asked,) = studies(study, {}, parameters, seed)
    with telling(command_name(study)) as say:
        result = asked.run(say)
    spec = asked.spec(result)
    show(result, asked.heading(spec))
    with status(f"writing {out}"):
        record.save_recording(result, out, spec=spec)
    return {**spec, **record.summary(result)}


def _command(kind: type[OutputOptions], task: str, parameters: Mapping[str, Any]) -> Any:
    """A command with parameters as its options, read as those that people type."""
    fields = {field.name: str(field.type) for field in dataclasses.fields(kind)}
    arguments = []
    for name, value in parameters.items():
        if name not in fields:
            raise ValueError(f"--select: there is no detail of the task {task!r} with {name!r}")
        if "Positional" not in fields[name]:
            arguments.append("--" + name.replace("_", "-"))
        arguments += [str(one) for one in (value if isinstance(value, list) else [value])]
    return tyro.cli(kind, args=arguments, prog=f"jaxcell {command_name(kind)}")


def _costliest(parameters: Mapping[str, Any]) -> dict[str, int]:
    """The start and the goal of a plan that costs the most of all."""
    import numpy as np

    from .. import estimates
    from ..bounce import all_plans
    from ..runtime import configure_jax

    configure_jax()
    command = _command(Navigate, "plans", {**parameters, "start": 0, "goal": 0})
    cells = command.cells(lambda e: estimates.plans(e, **command.motion), "plans")
    with status(f"planning among all pairs of {cells.size:,} cells"):
        found = all_plans(
            cells, np.radians(command.bounces), command.keep, command.change, **command.motion
        )
        most, ends = -1.0, (0, 0)
        for begin in range(0, cells.size, _GOALS):
            costs = found.costs(np.arange(begin, min(begin + _GOALS, cells.size)))
            start, goal = np.unravel_index(costs.argmax(), costs.shape)
            if costs[start, goal] > most:
                most, ends = float(costs[start, goal]), (int(start), begin + int(goal))
    return {"start": ends[0], "goal": ends[1]}


def _room(parameters: Mapping[str, Any], seed: int, out: Path) -> dict[str, Any]:
    """The periodic groups in a random room."""
    import numpy as np

    from .. import record
    from ..bounce import bounce_groups, group_summary
    from ..runtime import configure_jax
    from ..space import CellSpace
    from ..sweep.tasks.rooms import room_of

    configure_jax()
    free, member = room_of(parameters, seed)
    cells = CellSpace.of_grid(free, member["directions"])
    angle, collision = math.radians(member["bounce"]), member["collision"]
    spec = {"task": "rooms", "seed": seed, **parameters}
    with status(f"mapping {cells.size:,} cells"):
        found = group_summary(cells, np.array([angle]), collision=collision)
        groups = bounce_groups(cells, angle, collision=collision)
    with status(f"writing {out}"):
        record.log_groups(out, cells, groups, bounce=angle, spec=spec)
    count = int(found.count[0])
    period, basin, transient = (
        np.asarray(one)[0, :count] for one in (found.period, found.basin, found.transient)
    )
    summary = {
        "positions": cells.positions,
        "groups": count,
        "longest_transient": int(transient.max()),
        "longest_period": int(period.max()),
        "periodic_cells": int(period.sum()),
        "largest_basin": int(basin.max()),
    }
    rows = [(name.replace("_", " "), value) for name, value in summary.items()]
    table("Computed again", ("variable", "value"), rows)
    return summary
