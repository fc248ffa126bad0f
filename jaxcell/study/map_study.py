import dataclasses
import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

import tyro

from .. import space
from ..base import memory
from ..base.limits import Collision, Crop, Piece, Unknown
from .parameters import AtLeastOne, Headings, Length, Limit, Metres, Pose
from .study import Study, about, numbers


# The help of commands does without NumPy, which rooms of programs need.
if TYPE_CHECKING:
    RoomLike: TypeAlias = space.RoomLike | space.CellSpace
else:
    RoomLike = Path | Any

# A map, the side of a cell, the number of directions, the radius of the robot, and what unknown
# pixels are, and the piece and the part of the map.
_Cut: TypeAlias = tuple[Any, float | None, int | None, float | None, Unknown, Piece | None, Crop]
# Tolerance of a heading, in degrees.
DIRECTION_DEG = 0.01


def read_part(unknown: Unknown, piece: Any, crop: Any) -> tuple[Unknown, Piece | None, Crop]:
    """Return the meaning of unknown pixels, and the numbers of the options `piece` and `crop`."""
    if piece not in (None, "all", "largest"):
        x, y = numbers("piece", piece, "mm", '"x,y" in metres, largest or all')
        piece = x, y
    if crop is not None:
        crop = tuple(numbers("crop", crop, "mmmm", '"x,y,x,y" in metres'))
    return unknown, piece, crop


@dataclasses.dataclass(frozen=True, kw_only=True)
class CellStudy(Study):
    """Base class of studies on the cells of a map."""

    headings: ClassVar[Headings] = {"How is the map read?": ("cell", "unknown", "piece", "crop")}

    map: tyro.conf.Positional[Annotated[RoomLike, tyro.conf.arg(constructor=Path)]] = (
        dataclasses.field(kw_only=False)
    )
    """Map: jaxcell .json, ROS map_server .yaml, ASCII grid .txt, or a name such as @lab_a. Also
    MovingAI .map, .geojson of polygons, and HouseExpo .json."""
    cell: Length | None = None
    """Side of a cell in metres; by default the side that the map suggests, or a round length for
    at least 200 positions."""
    unknown: Unknown = "wall"
    """Meaning of the pixels of a ROS map that its saver marked as unknown: walls (wall), or free
    floor (free)."""
    piece: Pose | None = None
    """Connected part of the free space that robots are in: largest, all, or the part around the
    point "x,y" in metres. By default all or, in a ROS map, the largest if it has at least 90% of
    the area."""
    crop: Pose | None = None
    """Part of a map of squares to read: two opposite corners "x,y,x,y" in metres."""

    def __post_init__(self) -> None:
        if not isinstance(self.map, str | Path):
            object.__setattr__(self, "map", _named(self.map))
        super().__post_init__()
        if self.unknown == "free" and not self._ros:
            raise ValueError(
                f"unknown: expected a ROS map, .yaml; {self._place} has no such pixels"
            )

    @property
    def _place(self) -> str:
        return self.map.name if isinstance(self.map, space.Workspace) else str(self.map)

    @property
    def _ros(self) -> bool:
        return isinstance(self.map, Path) and self.map.suffix.lower() in (".yaml", ".yml")

    def needed(self, extent: "space.Extent") -> float | int:
        """Estimate the memory in bytes that `run` needs on a map with the size `extent`."""
        return space.estimates.cutting(extent)

    def written(self, extent: "space.Extent") -> float | int:
        """Estimate the memory in bytes that it takes to run the study and to write its files."""
        return self.needed(extent)

    @property
    def smaller(self) -> str:
        """Other advice to save memory, before "use larger cells" in a `MemoryError`, or empty."""
        return ""

    def memory(self, written: bool = False) -> float | int:
        extent = space.Extent.about(*_chosen(self._cut))
        if extent is None:
            return 0
        about = self.name, getattr(self, "step", None), self.smaller
        if not written:
            return space.estimates.check(extent, self.needed, *about)
        try:
            return space.estimates.check(extent, self.written, f"{self.name} in files", *about[1:])
        except MemoryError as error:
            if (needed := self.needed(extent)) == self.written(extent):
                raise
            space.estimates.check(extent, self.needed, *about)
            fits = f"without files, about {memory.gigabytes(needed)} would do"
            raise MemoryError(f"{error}; {fits}") from None

    def cells(self) -> "space.CellSpace":
        """Divide the map into cells; raise `MemoryError` if `run` needs more than is free."""
        self.memory()
        return _cells(self._cut)

    @property
    def _part(self) -> tuple[Unknown, Piece | None, Crop]:
        return read_part(self.unknown, self.piece, self.crop)

    @property
    def _cut(self) -> _Cut:
        return self.map, self.cell, None, None, *self._part

    def spec(self, result: Any) -> dict[str, Any]:
        cells = result.cells
        about = {"name": cells.workspace.name, "cell_m": cells.cell, "positions": cells.positions}
        spec = {**super().spec(result), **about}
        unused = {name for name in ("piece", "crop") if spec[name] is None}
        unused |= set() if self._ros else {"unknown"}
        return {key: value for key, value in spec.items() if key not in unused}

    def headline(self, spec: dict[str, Any]) -> str:
        return f"{spec['name'] or spec['map']}: {spec['positions']:,} cells"


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotStudy(CellStudy):
    """Base class of studies of a robot on a map, for which all of a step must be free."""

    headings: ClassVar[Headings] = {
        "How does the robot move?": ("directions", "robot_radius", "step")
    }

    directions: AtLeastOne | None = None
    """Number of directions in which the robot can drive; by default as the map suggests, or 8."""
    robot_radius: Annotated[Metres, Limit(ge=0)] | None = None
    """Radius of a disc robot in metres; by default the radius in the map, or 0."""
    step: Length | None = None
    """Length of a step in metres; by default one cell."""

    @property
    def _cut(self) -> _Cut:
        return self.map, self.cell, self.directions, self.robot_radius, *self._part

    @property
    def motion(self) -> "space.Motion":
        """The length of a step and the collision rule, for functions such as
        `bounce.bounce_map`."""
        return space.Motion(self.step)

    def spec(self, result: Any) -> dict[str, Any]:
        cells = result.cells
        return {
            **super().spec(result),
            "robot_radius_m": cells.workspace.robot_radius,
            "directions": cells.directions,
            "cells": cells.size,
            "pieces": cells.workspace.pieces,
            "step_m": cells.cell if self.step is None else self.step,
        }

    def headline(self, spec: dict[str, Any]) -> str:
        pieces = spec["pieces"]
        return (
            f"{spec['name'] or spec['map']}: {spec['positions']:,} positions x "
            f"{spec['directions']} directions = {spec['cells']:,} cells"
            + (f", {pieces} separate pieces" if pieces > 1 else "")
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapStudy(RobotStudy):
    """Base class of studies of a bouncing robot on a map."""

    headings: ClassVar[Headings] = {"How does the robot move?": ("collision",)}

    collision: Collision = "swept"
    """Part of a step that must be free: all (swept), or only its end, as in Alam 2018
    (endpoint)."""

    @property
    def motion(self) -> "space.Motion":
        return space.Motion(self.step, self.collision)


def _named(room: Any) -> "space.Workspace":
    """Return the map of a room of a program, with a name for results."""
    cut: dict[str, Any] = {}
    if isinstance(room, space.CellSpace):
        cut, room = {"cell": room.cell, "directions": room.directions}, room.room
    workspace = space.Workspace.of_input(room)
    name = workspace.name or "a room of the program"
    return dataclasses.replace(workspace, name=name, **cut)


def cell_at(cells: "space.CellSpace", text: Any, parameter: str) -> int:
    """Parse a cell: its number, or a pose `x,y,heading` (m, degrees), as a text or as numbers.

    Errors name `parameter`.
    """
    text = ",".join(map(str, text)) if isinstance(text, tuple | list) else str(text)
    if text.removeprefix("-").isdecimal():
        with about(f"{parameter} {text!r}"):
            cells.centre(int(text))
        return int(text)
    expected = '"x,y,heading" in metres and degrees, or a cell number'
    x, y, heading = numbers(parameter, text, ("m", "m", "deg"), expected)
    width = 360 / cells.directions
    if abs(math.remainder(heading, width)) > DIRECTION_DEG:
        raise ValueError(
            f"{parameter} {text!r}: expected a heading that is one of the {cells.directions} "
            f"directions, a multiple of {width:g} degrees, got {heading:g}"
        )
    with about(f"{parameter} {text!r}"):
        return int(cells.index(x, y, math.radians(heading)))


def disc_at(
    cells: "space.CellSpace", text: Any, parameter: str
) -> tuple[tuple[float, float], float]:
    """Parse the centre and the radius of a disc, `x,y` or `x,y,radius` in metres.

    By default the radius is the side of a cell, or half a metre if cells are smaller. Errors name
    `parameter`.
    """
    text = ",".join(map(str, text)) if isinstance(text, tuple | list) else str(text)
    units = "mm" if text.count(",") == 1 else "mmm"
    x, y, *given = numbers(parameter, text, units, '"x,y" or "x,y,radius" in metres')
    (radius,) = given or [max(cells.cell, 0.5)]
    Limit(gt=0).check(f"{parameter} {text!r}: radius", radius, " m")
    with about(f"{parameter} {text!r}"):
        cells.index(x, y)
    return (x, y), radius


@functools.lru_cache(maxsize=8)
def _chosen(cut: _Cut) -> "tuple[space.Workspace, float, int]":
    from ..space.cells import suggested

    return suggested(*cut)


# The cache serves the members of a sweep, because cell spaces keep computed results.
@functools.lru_cache(maxsize=8)
def _cells(cut: _Cut) -> "space.CellSpace":
    return space.CellSpace.of(*_chosen(cut))
