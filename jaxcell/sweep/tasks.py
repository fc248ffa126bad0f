"""The built-in tasks of sweeps: the studies of jaxcell, for many parameters.

The parameters of a task have the names and units of the options of its command. Each may be in the
batch or in the fixed values. This module does not import JAX.
"""

from ..study import STUDIES


TASKS: dict[str, str] = {
    study.task: f"{study.__module__}:{study.__name__}" for study in STUDIES if study.task
}
