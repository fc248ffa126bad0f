"""The built-in tasks of sweeps: the studies of jaxcell, for many parameters.

A task takes its parameters by the names of the options of its command, in their units, from the
batch or from the fixed values alike. Importing this imports no JAX.
"""

from ..study import STUDIES


TASKS: dict[str, str] = {
    study.task: f"{study.__module__}:{study.__name__}" for study in STUDIES if study.task
}
