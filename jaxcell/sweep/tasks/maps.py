"""What the tasks on maps share: the options of the commands that read one."""

import functools
from typing import TYPE_CHECKING, Any

from .parameters import Parameter, number, one_of, text, whole


if TYPE_CHECKING:
    from ...space import CellSpace


_length = number("more than 0 m", lambda x: x > 0)

MAP = {
    "map": Parameter(text, file=True),
    "directions": Parameter(whole(1), None),
    "cell": Parameter(_length, None),
    "robot_radius": Parameter(number("0 m or more", lambda x: x >= 0), None),
}
MOTION = {
    "step": Parameter(_length, None),
    "collision": Parameter(one_of("swept", "endpoint"), "swept"),
}


def cells_of(member: dict[str, Any]) -> "CellSpace":
    """The cells of a map, by the options `map`, `directions`, `cell` and `robot_radius`."""
    return _cells(member["map"], *(member.get(name) for name in MAP if name != "map"))


# The cells of a map keep what has been found out about them.
@functools.lru_cache(maxsize=8)
def _cells(
    path: str, directions: int | None, cell: float | None, robot_radius: float | None
) -> "CellSpace":
    from ...space import CellSpace

    return CellSpace.load(path, cell=cell, directions=directions, robot_radius=robot_radius)


def motion_of(member: dict[str, Any]) -> dict[str, Any]:
    """How the robot moves, for the functions of `jaxcell.bounce`."""
    return {name: member[name] for name in MOTION}
