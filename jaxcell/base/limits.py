"""Largest sizes, and names of options, that several packages share."""

from typing import Literal, TypeAlias


MAX_VERTICES = 2_000
"Largest number of vertices of a graph whose random walks are optimised and analysed."

MAX_CELLS = 5_000
"Largest number of cells of a patrolled map; a first-order solver is used above `MAX_VERTICES`."

Collision: TypeAlias = Literal["swept", "endpoint"]
"Name of a rule by which walls block a step; see `jaxcell.space.Motion`."

Unknown: TypeAlias = Literal["wall", "free"]
"Meaning of unknown pixels of a ROS map; see `jaxcell.space.Workspace.load`."

Crop: TypeAlias = tuple[float, float, float, float] | None
"Two opposite corners, x, y, x, y in metres, of the part of a map of squares to read."

Piece: TypeAlias = Literal["all", "largest", "main"] | tuple[float, float]
"The part of the free space that robots are in; see `jaxcell.space.Workspace`."
