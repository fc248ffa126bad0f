"""One member of a sweep in detail: its study answered again, shown and recorded."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...study import Study
from ...sweep.tasks import TASKS
from ...sweep.workers.work import study_of
from ..study import command_name
from ..terminal import progress, status


def detailed_study(task: str) -> type[Study]:
    """The study of a task.

    **Raises:** `ValueError` if the task is a function, whose members have no detail to show.
    """
    if (study := study_of(task)) is None:
        raise ValueError(
            f"--select: the task {task!r} has no detail to show; those that have are studies of "
            f"yours, and {', '.join(sorted(TASKS))}"
        )
    return study


def member_detail(
    study: type[Study], parameters: Mapping[str, Any], seed: int, out: Path
) -> dict[str, Any]:
    """Answer the study of a member again, print its tables, and write its recording.

    **Arguments:**

    - `study`: that of the sweep.
    - `parameters`: those of the member.
    - `seed`: of the sweep.
    - `out`: the recording, whose folder exists.

    **Returns:** the summary that the command prints as JSON.
    """
    from ... import record
    from ...base.runtime import configure_jax
    from ...sweep.study_task import studies
    from ..tables import show

    configure_jax()
    (asked,) = studies(study, {}, parameters, seed)
    with progress(command_name(study)) as say:
        result = asked.run(say)
    spec = asked.spec(result)
    show(result, asked.headline(spec))
    with status(f"writing {out}"):
        record.save_recording(result, out, spec=spec)
    return {**spec, **record.summary(result)}
