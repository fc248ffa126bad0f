"""Sizes and choices that several packages share."""

from typing import Literal, TypeAlias


MAX_VERTICES = 2_000
"Vertices of a graph whose walks are optimised and measured."

MAX_CELLS = 5_000
"Cells of a map whose patrols are optimised; above `MAX_VERTICES` by steps of first order."

Collision: TypeAlias = Literal["swept", "endpoint"]
"Names of the rules by which walls block a step; see `jaxcell.space.Motion`."
