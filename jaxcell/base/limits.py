"""Limits of sizes, and choices of options, that several packages share."""

from typing import Literal, TypeAlias


MAX_VERTICES = 2_000
"Largest number of vertices of a graph for which walks are optimised and measured."

MAX_CELLS = 5_000
"Largest number of cells of a patrolled map. Above `MAX_VERTICES`, first-order methods are used."

Collision: TypeAlias = Literal["swept", "endpoint"]
"Name of a rule by which walls block a step; see `jaxcell.space.Motion`."
