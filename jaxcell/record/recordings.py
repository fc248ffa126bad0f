import importlib
import os
from collections.abc import Callable, Mapping
from typing import Any

from ..base.optional_modules import has_module, import_module
from ..base.quantities import Result


# Module and function for each class of results, as names, so that only one module is imported.
_FAMILIES = {
    "AdaptivelyLocalized": "bounce.policy:log_localization_policy",
    "Anywhere": "bounce.anywhere:log_anywhere",
    "Basins": "dynamics.basins:log_basins",
    "BounceGroups": "bounce.groups:log_groups",
    "Continuation": "dynamics.basins:log_continuation",
    "CountedDrift": "drift.counted:log_counted_drift",
    "CostSummary": "bounce.navigation:log_navigation",
    "CoveragePolicy": "bounce.coverage:log_coverage",
    "Dropped": "drift.dropped:log_dropped",
    "Escape": "dynamics.escape:log_escape",
    "GraphPatrol": "patrol.graph:log_patrol_graph",
    "Guarded": "patrol.rounds:log_rounds",
    "Localized": "bounce.localization:log_localization",
    "MorseSets": "dynamics.morse:log_morse_sets",
    "ObservedDrift": "drift.observed:log_observed_drift",
    "PatrolledMap": "patrol.map:log_patrol_map",
    "Plan": "bounce.navigation:log_navigation",
    "Released": "drift.released:log_released",
    "Slipped": "bounce.slipping:log_slip",
    "SeaDrift": "drift.sea:log_drift",
    "TeamTrajectory": "bounce.team:log_team",
}


def save_recording(
    result: Result, path: str | os.PathLike[str], *, spec: Mapping[str, Any] | None = None
) -> None:
    """Write a Rerun recording of a result.

    Most classes of results have a special recording. The recording of other results has a map
    per quantity over positions, a curve per quantity over steps, and a text with the numbers.

    **Arguments:**

    - `result`: the result of a study.
    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `spec`: the parameters of the study, which the text shows.

    **Raises:** `ValueError` if the name does not end in `.rrd`; `OSError` if the file cannot be
    written; `ModuleNotFoundError` without Rerun, which `jaxcell[view]` installs.

    The groups of a robot that bounces in a lab:

        >>> from jaxcell import examples, record, study
        >>> groups = study.Groups(map="@lab_a", bounce=(45.0,)).run()
        >>> path = examples.folder() / "groups.rrd"
        >>> record.save_recording(groups, path)
        >>> path.exists()
        True
    """
    import_module("rerun")
    from .canvas.stream import recording

    log, kind = _log_of(result)
    with recording(path, kind) as stream:
        log(stream, result, spec or {})


def show(result: Result, *, spec: Mapping[str, Any] | None = None) -> Any:
    """Show the recording of a result in a notebook, or a plot if Rerun is not installed.

    **Arguments:**

    - `result`: the result of a study.
    - `spec`: the parameters of the study, which the text of the recording shows.

    **Returns:** a viewer if `rerun-sdk[notebook]` is installed, otherwise the axes of the plot.

    The groups of a robot that bounces in a lab:

        >>> from jaxcell import record, study
        >>> groups = study.Groups(map="@lab_a", bounce=(45.0,)).run()
        >>> shown = record.show(groups)
    """
    if not has_module("rerun_notebook"):
        return result.plot()
    from rerun.notebook import Viewer

    from .canvas.stream import new_stream

    log, kind = _log_of(result)
    stream = new_stream(kind)
    viewer = Viewer(recording=stream, width="auto")
    log(stream, result, spec or {})
    return viewer


def _log_of(result: Result) -> tuple[Callable[..., None], str]:
    """Find the function that logs a result, and the kind of its recording."""
    names = (kind.__name__ for kind in type(result).__mro__)
    family = next((_FAMILIES[name] for name in names if name in _FAMILIES), "default:log_result")
    module, _, function = family.partition(":")
    log = getattr(importlib.import_module(f".{module}", __package__), function)
    return log, function.removeprefix("log_")
