"""Limits of sizes, and choices of options, that several packages share."""

from typing import Literal, TypeAlias


MAX_VERTICES = 2_000
"Largest number of vertices of a graph for the optimisation and the measures of walks."

MAX_CELLS = 5_000
"Largest number of cells of a map for patrols; above `MAX_VERTICES` by first-order methods."

Collision: TypeAlias = Literal["swept", "endpoint"]
"Name of a rule by which walls block a step; see `jaxcell.space.Motion`."
