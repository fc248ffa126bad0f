"""The built-in tasks of sweeps: what the commands compute, for many parameters.

A task takes its parameters by the names of the options of its command, in their units, from the
batch or from the fixed values alike. Importing this imports no task, and no JAX.
"""

TASKS: dict[str, str] = {
    "groups": "jaxcell.study:Groups",
    "rooms": "jaxcell.study:Rooms",
    "localize": "jaxcell.study:Localize",
    "cover": "jaxcell.study:Cover",
    "plans": "jaxcell.study:Plans",
    "patrol": "jaxcell.study:PatrolGraph",
    "drift": "jaxcell.study:Drift",
    "drifters": "jaxcell.study:Drifters",
    "dynamics": "jaxcell.study:Dynamics",
}
