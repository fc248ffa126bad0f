"""One member of a sweep in detail: what the command of its task writes for its parameters."""

import dataclasses
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tyro

from ..study import Study
from ..sweep.tasks import TASKS
from ..sweep.work import study_of
from .drift import Drift
from .options import OutputOptions, command_name
from .terminal import status, telling


# The command of a task, whose options are the parameters of the task, and its recording.
_COMMANDS: dict[str, tuple[type[OutputOptions], str]] = {
    "drift": (Drift, "drift.rrd"),
}


def check_detail(task: str) -> None:
    """Raises `ValueError` if members of a task have no detail to show."""
    if task not in _COMMANDS and study_of(task) is None:
        raise ValueError(
            f"--select: the task {task!r} has no detail to show; those that have are "
            f"{', '.join(sorted(TASKS))}"
        )


def member_detail(task: str, parameters: Mapping[str, Any], seed: int, out: Path) -> dict[str, Any]:
    """Computes a member again, prints what is found, and writes its recording.

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
    command, recording = _COMMANDS[task]
    if task == "drift":
        parameters = _one_layer(parameters)
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


def _one_layer(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a member of `drift`, which is one layer, as options of the command."""
    options = dict(parameters)
    if "depth" in options:
        options["depths"] = options.pop("depth")
    elif "duration" not in options:
        # The command takes all layers, and a step that is long enough for the slowest.
        from ..drift import Flow, Water, crossing_time, open_currents

        currents = open_currents(options["file"], time=parameters.get("time"))
        options["duration"] = crossing_time(Water.of(currents, 0), Flow.of(currents, 0).mean())
    return options
