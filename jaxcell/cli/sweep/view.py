import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import tyro

from ... import record, sweep
from ...base.process import has_display
from ...study import Study
from ...sweep.storage.damage import reading
from ...sweep.tasks import TASKS
from ..startup import prepare_tasks
from ..terminal import note, own_command, progress, show, status, table
from ..view import View
from .indices import show_indices
from .run import in_a_line


if TYPE_CHECKING:
    import xarray as xr


_MAX_LISTED = 6
# Relative tolerance for numbers that a user types with fewer digits.
_TYPED = 1e-5


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepView:
    """Show a sweep in the Rerun viewer: its parameters as timelines, or one member in detail.

    For a sweep with the design saltelli, print the Sobol indices too.

    Exit status: 0 the recording is made, 1 the member has no result, 2 bad input."""

    example: ClassVar[str] = "runs/rooms"

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    select: tuple[str, ...] = ()
    """Member to compute again and show in detail, as NAME=VALUE for each dimension of the sweep."""
    out: Path | None = None
    """File of the recording; by default, in FOLDER, overview.rrd or members/NAME=VALUE.rrd."""

    def run(self) -> int:
        from ...sweep.storage.store import SweepStore

        if self.out is not None and self.out.suffix != ".rrd":
            raise ValueError(f"--out {self.out}: expected the name of a recording, FILE.rrd")
        state = sweep.sweep_status(self.folder)
        with SweepStore(self.folder) as store:
            spec = store.spec
        if self.select:
            return self._member(spec, state.failures)
        failures = [in_a_line(failure) for failure in state.failures]
        out = self.folder / "overview.rrd" if self.out is None else self.out
        with sweep.open_sweep(self.folder) as dataset, status(f"writing {out}"):
            with reading(self.folder):
                dataset.load()
            record.log_sweep(out, dataset, failures=failures)
        if spec.has_indices and state.complete:
            show_indices(self.folder, sweep.sobol_indices(self.folder))
        return _open(out)

    def _member(self, spec: "sweep.Spec", failures: "Sequence[sweep.Failure]") -> int:
        from ...sweep.workers.work import with_files_found, with_task_found

        prepare_tasks()
        spec = with_task_found(spec)
        study = detailed_study(spec.task)
        places = selected(spec, self.select)
        name = ",".join(re.sub(r"[^\w.=+-]+", "_", f"{k}={v}") for k, v in named(spec, places))
        with sweep.open_sweep(self.folder) as dataset, reading(self.folder):
            member = dataset.isel(places).load()
        state = int(member["status"])
        if state != 1:
            messages = [failure.message for failure in failures if failure.index == places]
            reason = "; ".join(messages) if state == 2 else "it is not computed yet"
            note(f"The member {name} has no result: {reason}")
            return 1
        out = self.folder / "members" / f"{name}.rrd" if self.out is None else self.out
        out.parent.mkdir(parents=True, exist_ok=True)
        _show(name, member)
        member_detail(study, parameters(with_files_found(spec), places), spec.seed, out)
        return _open(out)


def detailed_study(task: str) -> type[Study]:
    """Return the study of a task, or raise `ValueError` if the task is a function."""
    from ...sweep.workers.work import study_of

    if (study := study_of(task)) is None:
        raise ValueError(
            f"--select: the task {task!r} has no detail to show; expected a study of yours, or "
            f"one of {', '.join(sorted(TASKS))}"
        )
    return study


def member_detail(
    study: type[Study], parameters: Mapping[str, Any], seed: int, out: Path
) -> dict[str, Any]:
    """Run the study of a member again, print its tables, record it, and return a summary."""
    from ...base.runtime import configure_jax
    from ...sweep.study_task import member_study

    configure_jax()
    question = member_study(study, parameters, seed)
    with progress(study.command or study.name) as say:
        result = question.run(say)
    spec = question.spec(result)
    show(result, question.headline(spec))
    with status(f"writing {out}"):
        record.save_recording(result, out, spec=spec)
    return {**spec, **record.summary(result)}


def selected(spec: "sweep.Spec", given: Sequence[str]) -> dict[str, int]:
    """Find the index of a member along each dimension of a sweep.

    `given` contains `NAME=VALUE` for each dimension with several values. `VALUE` is the value of a
    grid parameter; for samples and lists it is an index from 0.
    """
    values = dict(_values(spec))
    listed = ", ".join(values)
    places: dict[str, int] = {}
    for option in given:
        name, equals, value = option.partition("=")
        if not equals or name not in values:
            raise ValueError(f"--select {option}: expected NAME=VALUE with a name among {listed}")
        if name in places:
            raise ValueError(f"--select {option}: {name} comes twice")
        places[name] = _place(option, value, values[name])
    for name, choices in values.items():
        if name not in places and len(choices) > 1:
            raise ValueError(
                f"--select: expected a value for each of {listed}; {name} is missing, one of "
                f"{_listed(choices)}"
            )
    return {name: places.get(name, 0) for name in values}


def parameters(spec: "sweep.Spec", places: Mapping[str, int]) -> dict[str, Any]:
    """Return all parameters of a member; `places` contains its index along each dimension."""
    return {**spec.fixed, **spec.member(places)}


def named(spec: "sweep.Spec", places: Mapping[str, int]) -> list[tuple[str, Any]]:
    return [(name, choices[places[name]]) for name, choices in _values(spec)]


def _values(spec: "sweep.Spec") -> list[tuple[str, list[Any]]]:
    """Return the labels along each dimension: the values of a grid parameter, else 0, 1, 2, ..."""
    own = {
        each.name: each.values.tolist() for each in spec.parameters if each.name == each.dimension
    }
    return [(name, own.get(name) or [*range(size)]) for name, size in spec.dimensions.items()]


def _place(option: str, text: str, values: Sequence[Any]) -> int:
    error = ValueError(f"--select {option}: there is no such value; there are {_listed(values)}")
    if isinstance(values[0], str | bool):
        texts = [str(value) for value in values]
        wanted = text if isinstance(values[0], str) else text.capitalize()
        if wanted not in texts:
            raise error
        return texts.index(wanted)
    try:
        number = float(text)
    except ValueError:
        raise error from None
    apart = [abs(value - number) for value in values]
    nearest = apart.index(min(apart))
    if not apart[nearest] <= _TYPED * abs(number):
        raise ValueError(f"{error}; the nearest is {values[nearest]}")
    return nearest


def _listed(values: Sequence[Any]) -> str:
    if len(values) <= _MAX_LISTED:
        return ", ".join(map(str, values))
    return f"{', '.join(map(str, values[: _MAX_LISTED - 2]))}, ..., {values[-1]}"


def _show(name: str, member: "xr.Dataset") -> None:
    rows = [
        (array.attrs.get("long_name", key), f"{array.item():.6g}", array.attrs.get("units", ""))
        for key, array in member.data_vars.items()
        if key != "status" and not array.dims and array.dtype.kind in "biuf"
    ]
    table(f"In the sweep: {name}", ("variable", "value", "unit"), rows)


def _open(recording: Path) -> int:
    """Open a recording, or print the command that opens it."""
    if has_display():
        return View(results=recording).run()
    note(
        f"The recording is {recording}; to look at it in a browser on this machine: "
        f"{own_command('view', '--web', recording)}"
    )
    return 0
