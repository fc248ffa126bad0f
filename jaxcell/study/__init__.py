"""Studies: classes that each answer one question. The fields are the parameters of the question.

The method `run` returns the answer. The fields are also the options of a command, the parameters of
a task in sweeps, and the `spec` in datasets and recordings. A program calls a study like this:

    >>> from jaxcell import bundled, study
    >>> lab = bundled("maps/lab_a.json")
    >>> angles = dict(bounce=(45.0, 90.0), errors="turn=45deg", directions=8)
    >>> result = study.Cover(map=lab, reliability=0.7, **angles).run()
    >>> result.mixture.shape, round(result.total_variation, 3)
    ((19,), 0.355)

`STUDIES` lists the studies of jaxcell. Each study has a command, a help page, a task in sweeps, and
tests. Your own class that derives from [`Study`][jaxcell.study.Study] also runs as `jaxcell run
FILE.py:CLASS`, and as the task of a sweep.

The studies do not use the command line or sweeps. Importing this package does not import JAX.
"""

import types

from ..base import optional_modules


if not optional_modules.has_module("tyro"):
    raise optional_modules.missing_module("tyro")

from .bounce.angles import ChooseAngles as ChooseAngles
from .bounce.anywhere import (
    LocalizeAnywhere as LocalizeAnywhere,
    NavigateAnywhere as NavigateAnywhere,
)
from .bounce.cover import Cover as Cover
from .bounce.groups import Groups as Groups
from .bounce.localize import Localize as Localize, LocalizeSlip as LocalizeSlip
from .bounce.navigate import Navigate as Navigate, NavigateSlip as NavigateSlip, Plans as Plans
from .bounce.rooms import Rooms as Rooms
from .bounce.team import Team as Team
from .drift.deploy import Deploy as Deploy
from .drift.drift import Drift as Drift
from .drift.observed_drifters import Drifters as Drifters
from .drift.release import Release as Release
from .dynamics import Dynamics as Dynamics
from .escape import Escape as Escape
from .map_study import CellStudy as CellStudy, MapStudy as MapStudy
from .morse import Morse as Morse
from .parameters import (
    AtLeastOne as AtLeastOne,
    Count as Count,
    Days as Days,
    Degrees as Degrees,
    Limit as Limit,
    Metres as Metres,
    Needed as Needed,
    Only as Only,
    Seconds as Seconds,
    WholeNumber as WholeNumber,
    parameters as parameters,
)
from .patrol.patrol_graph import PatrolGraph as PatrolGraph
from .patrol.patrol_guard import PatrolEvaluate as PatrolEvaluate, PatrolGuard as PatrolGuard
from .patrol.patrol_map import PatrolMap as PatrolMap
from .study import Study as Study, silent as silent


STUDIES: tuple[type[Study], ...] = (
    ChooseAngles,
    Cover,
    Deploy,
    Drift,
    Drifters,
    Dynamics,
    Escape,
    Groups,
    Localize,
    LocalizeAnywhere,
    LocalizeSlip,
    Morse,
    Navigate,
    NavigateAnywhere,
    NavigateSlip,
    PatrolEvaluate,
    PatrolGraph,
    PatrolGuard,
    PatrolMap,
    Plans,
    Release,
    Rooms,
    Team,
)


def __dir__() -> list[str]:
    return [name for name, value in globals().items() if not isinstance(value, types.ModuleType)]
