import dataclasses
import functools
import math
import numbers
import os
import re
import reprlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
import shapely
from jaxtyping import Float, Int

from ..base.bundled import with_path
from ..base.documents import about
from ..base.doubts import Doubt, warn
from ..base.formatting import percent
from ..base.limits import Crop, Piece, Unknown
from ..base.shown import Pictured
from .maps.grid_files import grid_fields
from .maps.map_files import read_map, write_map
from .outlines import cut_along_axes


Ring: TypeAlias = npt.ArrayLike | shapely.Polygon
if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    RoomLike: TypeAlias = "str | os.PathLike[str] | Workspace | BaseGeometry | npt.ArrayLike"
    """A map, or what [`Workspace.of_input`][] converts to one."""
else:
    RoomLike = Any

# Beyond this (metres) the spacing of float64 is coarser than a nanometre.
_LARGEST_COORDINATE = 1e7
# The least share of the area of the free space in its main piece.
_MOST = 0.9


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Workspace(Pictured):
    """A map: a polygonal boundary minus polygonal obstacles, in metres (Alam 2018, section 2.3.1).

    Obstacles may touch or overlap the boundary and each other. The arrays are read-only.

    **Attributes:**

    - `boundary`: vertices of the boundary, in order, without repeating the first at the end.
    - `obstacles`: vertices of each obstacle, in the same form.
    - `robot_radius`: radius of a disc robot; 0 for a point.
    - `name`: the name of the map, one line of text.
    - `cell`: the suggested side of cells, in metres, or `None`.
    - `directions`: the suggested number of directions, or `None`.
    - `piece`: the part of the free space that robots are in: `"all"` of it, its `"largest"`
        connected piece, the piece around a point `(x, y)`, or `"main"`, the largest if it has at
        least 90 percent of the free space, else all, as maps from pictures have it.

    A room with a pillar, for a robot of radius 0.5 m:

        >>> from jaxcell import space
        >>> pillar = [(2, 2), (3, 2), (3, 3), (2, 3)]
        >>> room = space.Workspace([(0, 0), (8, 0), (8, 4), (0, 4)], [pillar], name="hall")
        >>> room.environment.area, room.pieces
        (31.0, 1)
        >>> room.describe()
        'hall: 8 x 4 m, 1 obstacle, free space 31 m² in one piece'
    """

    boundary: Float[np.ndarray, "vertices 2"] = dataclasses.field(repr=False)
    obstacles: tuple[Float[np.ndarray, "_ 2"], ...] = dataclasses.field(repr=False)
    robot_radius: float
    name: str
    cell: float | None
    directions: int | None
    piece: Piece

    def __init__(
        self,
        boundary: Ring,
        obstacles: Sequence[Ring] | shapely.Polygon | shapely.MultiPolygon = (),
        robot_radius: float | int = 0.0,
        name: str = "",
        cell: float | int | None = None,
        directions: int | None = None,
        piece: Piece = "all",
    ) -> None:
        """Create a map, and check it.

        A polygon is a shapely polygon without holes, or the vertices of a simple polygon, in either
        order; the first vertex may be repeated at the end. The obstacles may be one shapely polygon
        or multipolygon.

        **Raises:** `ValueError` for a polygon that crosses or touches itself or has no area, a
        vertex beyond 10^7 m, an obstacle outside, or a map in which the robot fits nowhere.
        """
        if isinstance(obstacles, shapely.Polygon | shapely.MultiPolygon):
            obstacles = shapely.get_parts(obstacles).tolist()
        boundary, *rings = (_ring(_field(i), ring) for i, ring in enumerate([boundary, *obstacles]))
        values = {
            "boundary": boundary,
            "obstacles": tuple(rings),
            "robot_radius": _number("robot_radius", robot_radius),
            "name": name,
            "cell": None if cell is None else _number("cell", cell),
            "directions": directions,
            "piece": piece,
        }
        for field, value in values.items():
            object.__setattr__(self, field, value)
        _check_coordinates([boundary, *rings])
        _check_polygons(self._shapes, coordinate_rounding(boundary, rings))
        self._check_numbers()
        if self.environment.is_empty:
            raise ValueError("obstacles: they cover the whole boundary; nothing is left free")
        if self._whole_space.is_empty:
            raise ValueError(
                f"robot_radius: a robot of radius {self.robot_radius:g} m fits nowhere in the map"
            )

    def _check_numbers(self) -> None:
        if not self.robot_radius >= 0:
            raise ValueError(f"robot_radius: expected 0 m or more, got {self.robot_radius:g}")
        if self.robot_radius > _LARGEST_COORDINATE:
            raise ValueError(
                f"robot_radius: expected at most {_LARGEST_COORDINATE:g} m, got "
                f"{self.robot_radius:g}"
            )
        if self.cell is not None and not self.cell > 0:
            raise ValueError(f"cell: expected more than 0 m, got {self.cell:g}")
        directions = self.directions
        if directions is not None and (type(directions) is not int or directions < 1):
            raise ValueError(f"directions: expected a whole number from 1, got {directions!r}")
        if not self.name.isprintable():
            raise ValueError(f"name: expected printable text on one line, got {self.name!r}")

    @functools.cached_property
    def _shapes(self) -> np.ndarray:
        """The polygons of the boundary and, after it, of the obstacles."""
        rings = self.boundary, *self.obstacles
        of = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
        return shapely.polygons(shapely.linearrings(np.concatenate(rings), indices=of))

    @functools.cached_property
    def environment(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The free space of a point robot: the boundary minus the union of the obstacles.

        Vertices are rounded to multiples of 10^-13 times the next power of ten above the largest
        coordinate (10^-12 m in a map of 8 m). So polygons that are meant to touch do touch, even if
        the rounding of float64 separates their vertices.
        """
        rounding = coordinate_rounding(self.boundary, self.obstacles)
        along_axes = cut_along_axes(self._shapes, rounding)
        if along_axes is not None:
            return along_axes
        # NumPy would warn of the denormal numbers that GEOS meets in slivers.
        with np.errstate(all="ignore"):
            union = shapely.disjoint_subset_union_all(self._shapes[1:])
            return shapely.normalize(shapely.difference(self._shapes[0], union, grid_size=rounding))

    @functools.cached_property
    def free_space(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The space for the robot's centre: the environment less a margin of the robot's radius.

        Around a convex corner of an obstacle the margin is an arc of about 16 chords per quarter
        circle; a chord may have half as large an angle again. So the margin is up to 0.27 percent
        too narrow there. The free space may have several pieces, of which `piece` chooses.
        """
        parts = shapely.get_parts(self._whole_space)
        if self.piece == "all" or (parts.size == 1 and isinstance(self.piece, str)):
            return self._whole_space
        areas = shapely.area(parts)
        kept = int(areas.argmax())
        if isinstance(self.piece, tuple):
            around = shapely.intersects_xy(parts, *self.piece)
            if not around.any():
                inside = parts[kept].representative_point()
                raise ValueError(
                    f"piece: no robot can be at {self.piece[0]:g},{self.piece[1]:g}; expected a "
                    f"point of the free space, such as {inside.x:.3g},{inside.y:.3g}"
                )
            kept = int(around.argmax())
        share = areas[kept] / areas.sum()
        if self.piece == "main":
            small = share < _MOST
            used = "all are used, the largest with" if small else "only the largest is used, with"
            other = "one of them, set `piece`" if small else 'all of them, set `piece="all"`'
            pieces = f"the free space has {parts.size:,} separate pieces"
            name = f"{self.name}: " if self.name else ""
            warn(f"{name}{pieces}: {used} {percent(share)} of its area; for {other}", Doubt)
            if small:
                return self._whole_space
        return parts[kept]

    @functools.cached_property
    def _whole_space(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The space for the robot's centre in all pieces."""
        # GEOS turns polygons inside out for margins below the rounding of float64.
        if self.robot_radius <= coordinate_rounding(self.boundary, self.obstacles):
            return self.environment
        # GEOS may get the margin of touching pieces wrong; the margin of each polygon is right.
        margin = self.robot_radius
        inside = self._shapes[0].buffer(-margin, quad_segs=16)
        solid = shapely.buffer(self._shapes[1:], margin, quad_segs=16)
        with np.errstate(all="ignore"):
            return shapely.normalize(shapely.difference(inside, shapely.union_all(solid)))

    @property
    def pieces(self) -> int:
        """The number of connected parts of the free space, between which no robot can move."""
        return len(shapely.get_parts(self.free_space))

    def describe(self) -> str:
        """Describe the map in one line: its name and size, and the pieces of its free space."""
        width, height = np.ptp(self.boundary, axis=0)
        text = f"{self.name}: " if self.name else ""
        count = len(self.obstacles)
        obstacles = "1 obstacle" if count == 1 else f"{count or 'no'} obstacles"
        text += f"{width:g} x {height:g} m, {obstacles}, "
        if self.robot_radius > 0:
            text += f"robot of radius {self.robot_radius:g} m, "
        text += f"free space {self.free_space.area:.6g} m² "
        if self.pieces == 1:
            return text + "in one piece"
        return text + f"in {self.pieces} pieces that the robot cannot cross between"

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], unknown: Unknown = "wall", crop: Crop = None
    ) -> "Workspace":
        """Read a map file.

        It may be a `.json` map of jaxcell or of HouseExpo, `.geojson` of polygons, a ROS map_server
        `.yaml`, or an ASCII grid or a grid of MovingAI, `.txt` or `.map`. The path of the image of
        a map_server map is relative to its `.yaml` file. A map without a name gets the name of its
        file. `crop` are two opposite corners, x, y, x, y, of the part of the squares to read.

        Pixels of a map_server map that are unknown are walls, or free if `unknown` is `"free"`.
        Pixels of the grey that savers of maps write for unknown are unknown even if `free_thresh`
        takes them as free; a warning of the class `jaxcell.base.doubts.Doubt` says how many.
        """
        path = with_path(os.fspath(path))
        fields = read_map(path, unknown, crop)
        with about(path):
            return cls(**fields)

    @classmethod
    def of_input(cls, room: RoomLike, unknown: Unknown = "wall", crop: Crop = None) -> "Workspace":
        """Create a map of what people have.

        It may be a map, a map file, or a name such as `@lab_a`; a shapely polygon, whose holes are
        obstacles; the vertices of a boundary; or a grid `[rows, columns]` that is `True` in free
        squares, which have sides of 1 m, row 0 at the bottom.
        """
        if isinstance(room, str | os.PathLike):
            return cls.load(room, unknown, crop)
        if crop is not None:
            raise ValueError("crop: it has no effect without a map file")
        if isinstance(room, cls):
            return room
        if isinstance(room, shapely.Polygon):
            return cls(room.exterior.coords, [hole.coords for hole in room.interiors])
        grid = np.asarray(room) if _is_grid(room) else None
        if grid is not None and grid.dtype == bool:
            return cls(**grid_fields(~grid, (0.0, 0.0), 1.0))
        if grid is not None:
            raise ValueError(
                f"map: expected a grid of booleans, such as grid > 0, got {grid.dtype}"
            )
        if isinstance(room, list | tuple | np.ndarray):
            return cls(room)
        raise ValueError(
            "map: expected a file, a Workspace, a shapely polygon, its vertices or a grid of "
            f"booleans, got {type(room).__name__}"
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a map file in the format that its suffix indicates, completely or not at all.

        A `.json` file keeps everything. A grid, `.txt` or `.map`, keeps the squares of side `cell`
        whose centre is free. A map_server file, `.yaml` or `.yml`, keeps these squares in an image
        with the suffix `.pgm`, but not the name, the radius and the number of directions.
        """
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        write_map(path, fields, self.environment)


def _is_grid(room: object) -> bool:
    """Check for two-dimensional arrays, and lists of booleans, that are not pairs of numbers."""
    if isinstance(room, list):
        return bool(room) and isinstance(room[0], list) and isinstance(room[0][0], bool)
    shape: Any = getattr(room, "shape", ())
    kind = getattr(getattr(room, "dtype", None), "kind", "")
    return len(shape) == 2 and (kind == "b" or (kind in "iuf" and shape[1] != 2))


def _number(field: str, value: object) -> float:
    if not isinstance(value, numbers.Real) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{field}: expected a finite number, got {value!r}")
    return float(value)


def _field(number: int | np.integer) -> str:
    """Name the boundary, which has the number 0, or an obstacle."""
    return f"obstacles[{number - 1}]" if number else "boundary"


def _ring(field: str, ring: Ring) -> Float[np.ndarray, "vertices 2"]:
    if isinstance(ring, shapely.Polygon):
        if ring.interiors:
            raise ValueError(
                f"{field}: expected a polygon without holes, got one with {len(ring.interiors)}"
            )
        ring = shapely.get_coordinates(ring)
    try:
        vertices = np.array(ring, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{field}: expected pairs of numbers [x, y], got {reprlib.repr(ring)}"
        ) from None
    if vertices.size == 0:
        raise ValueError(f"{field}: it has no vertices; at least 3 are needed")
    if vertices.ndim != 2 or vertices.shape[1] != 2:
        raise ValueError(
            f"{field}: expected pairs of numbers [x, y], got an array of shape {vertices.shape}"
        )
    # Lists, because NumPy is slow for a few numbers, and a map may have a million obstacles.
    points = list(map(tuple, vertices.tolist()))
    distinct = len(set(points))
    if distinct < 3:
        raise ValueError(f"{field}: it has {distinct} distinct vertices; at least 3 are needed")
    while points[0] == points[-1]:
        points.pop()
    vertices = vertices[: len(points)]
    vertices.setflags(write=False)
    return vertices


def _check_coordinates(rings: Sequence[Float[np.ndarray, "_ 2"]]) -> None:
    """Refuse coordinates that are not finite or too large."""
    points = np.concatenate(rings)
    wrong = np.flatnonzero(~(np.abs(points) <= _LARGEST_COORDINATE).all(axis=1))
    if wrong.size:
        starts = np.cumsum([0, *map(len, rings)])
        ring = int(np.searchsorted(starts, wrong[0], side="right")) - 1
        x, y = points[wrong[0]]
        raise ValueError(
            f"{_field(ring)}: vertex {wrong[0] - starts[ring]} is ({x:g}, {y:g}); "
            f"expected finite numbers of at most {_LARGEST_COORDINATE:g} m"
        )


def coordinate_rounding(
    boundary: Float[np.ndarray, "vertices 2"], obstacles: Sequence[Float[np.ndarray, "_ 2"]]
) -> float:
    """Compute the unit to which vertices are rounded; it exceeds rounding errors of float64."""
    largest = np.abs(np.concatenate((boundary, *obstacles))).max()
    return 10.0 ** (math.ceil(math.log10(largest)) - 13)


def polygons(geometries: np.ndarray) -> tuple[np.ndarray, Int[np.ndarray, "polygons"]]:
    """Split geometries into polygons; return them, and the index of the geometry of each."""
    parts, of = shapely.get_parts(geometries, return_index=True)
    polygonal = shapely.area(parts) > 0
    return parts[polygonal], of[polygonal]


def edges(environment: shapely.Geometry) -> Float[np.ndarray, "walls 3 2"]:
    """List the corner before each edge, its start and its end; the interior is to its left."""
    pieces, _ = polygons(np.array([environment]))
    rings = shapely.get_rings(shapely.orient_polygons(pieces))
    corners = [shapely.get_coordinates(ring)[:-1] for ring in rings]
    walls = [np.stack([np.roll(c, 1, 0), c, np.roll(c, -1, 0)], axis=1) for c in corners]
    return np.concatenate([np.empty((0, 3, 2)), *walls])


def _check_polygons(shapes: np.ndarray, rounding: float) -> None:
    """Refuse polygons that have no area or touch themselves, and obstacles outside the boundary."""
    small = np.flatnonzero(shapely.area(shapes) <= rounding * shapely.length(shapes))
    # The hull, because the areas of the two halves of a bow tie cancel.
    hulls = shapely.convex_hull(shapes[small])
    flat = small[shapely.area(hulls) <= rounding * shapely.length(hulls)]
    if flat.size:
        raise ValueError(f"{_field(flat[0])}: zero area; all its vertices lie on one line")

    crossed = np.flatnonzero(~shapely.is_valid(shapes))
    if crossed.size:
        reason = shapely.is_valid_reason(shapes[crossed[0]])
        place = re.fullmatch(r"(?:Ring )?(.*)\[(\S+) (\S+)\]", reason)
        if place:
            reason = f"{place[1].lower()} at ({place[2]}, {place[3]})"
        raise ValueError(f"{_field(crossed[0])}: {reason}; its edges may meet only at their ends")

    shapely.prepare(shapes[0])
    outside = np.flatnonzero(~shapely.relate_pattern(shapes[0], shapes[1:], "T********"))
    if outside.size:
        raise ValueError(f"{_field(1 + outside[0])}: it lies wholly outside the boundary")
