"""One member of a sweep in detail: run its study again, print it and record it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ... import record
from ...study import Study
from ...sweep.tasks import TASKS
from ...sweep.workers.work import study_of
from ..terminal import progress, show, status


def detailed_study(task: str) -> type[Study]:
    """Return the study of a task."""
    if (study := study_of(task)) is None:
        raise ValueError(
            f"--select: the task {task!r} has no detail to show; expected a study of yours, or "
            f"one of {', '.join(sorted(TASKS))}"
        )
    return study


def member_detail(
    study: type[Study], parameters: Mapping[str, Any], seed: int, out: Path
) -> dict[str, Any]:
    """Run the study of a member again, print its tables, and write its recording.

    **Returns:** the summary that the command prints as JSON.
    """
    from ...base.runtime import configure_jax
    from ...sweep.study_task import studies

    configure_jax()
    (question,) = studies(study, {}, parameters, seed)
    with progress(study.command or study.name) as say:
        result = question.run(say)
    spec = question.spec(result)
    show(result, question.headline(spec))
    with status(f"writing {out}"):
        record.save_recording(result, out, spec=spec)
    return {**spec, **record.summary(result)}
