"""The built-in tasks of sweeps: what the commands compute, for many parameters.

A task takes its parameters by the names of the options of its command, in their units, from the
batch or from the fixed values alike. Importing this imports no task, and no JAX.
"""

TASKS: dict[str, str] = {
    "groups": "jaxcell.sweep.tasks.groups:groups",
    "rooms": "jaxcell.sweep.tasks.rooms:rooms",
    "localize": "jaxcell.sweep.tasks.localize:localize",
    "cover": "jaxcell.study:Cover",
    "plans": "jaxcell.sweep.tasks.plans:plans",
    "patrol": "jaxcell.sweep.tasks.patrol:patrol",
    "drift": "jaxcell.study:Drift",
}
