import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int, Num

from ..base.memory import check
from .cells import TOLERANCE, CellSpace
from .segments import cross, meets_wall
from .view import check_reach, check_view, sees_all_around
from .workspace import edges, polygons


_CHUNK = 2**20


def visible_cells(
    cells: CellSpace,
    reach: float | int,
    *,
    field_of_view: float | int | None = None,
    heading: Float[np.ndarray, "..."] | float | int | None = None,
) -> Bool[np.ndarray, "*views positions positions"]:
    """Which cells are wholly visible from the centre of each (Alam 2018, Eq. 4.1 and Alg. 4.3).

    A point is visible if it is no farther than `reach` and the way to it stays in the closed
    environment. A cell is wholly visible if each point of its square that lies in the environment
    is; what an obstacle takes of a square need not be seen. (If it had to be, nobody could see the
    cells along a slanted wall.) A cell that a thin wall cuts in two may be visible from nowhere,
    not even from its own centre.

    Sight runs along walls and grazes corners. It does not pass between two obstacles that meet in a
    point. What hides less than 1e-9 of a cell hides nothing. The radius of the robot plays no part:
    it keeps the robot from the walls, but not its sight.

    This is exact for polygons of any shape: a wall hides a cell if its shadow overlaps it, and two
    convex polygons do not overlap if their projections onto the normal of some edge do not.

    **Arguments:**

    - `cells`: the cell space.
    - `reach`: range of sight, in metres; may be infinite.
    - `field_of_view`: angle that a camera sees at once, in radians, up to `2 * pi`; `None` for all
        around. A camera that sees less than all around does not wholly see the cell it stands in.
    - `heading`: where the middle of its view points, in radians counter-clockwise from East: a
        number, or an array whose last axis has an entry for each position (or a single one for
        all). Axes before it are views, each of which gets a matrix of its own:
        `2 * pi * np.arange(d)[:, None] / d` is the directions of a space that has `d`.

    **Returns:**

    `visible[..., i, j]`: whether `j` is wholly visible from the centre of `i`. It takes a byte for
    each pair: 100 MB for 10,000 positions.

    **Raises:** `ValueError` if a number is out of range, or if only one of `field_of_view` and
    `heading` is given; `MemoryError` where the pairs would not fit the free memory.

    In a corridor of three squares; the far corners of the next one are 1.58 m away:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> space.visible_cells(cells, reach=1.6).astype(int).tolist()
        [[1, 1, 0], [1, 1, 1], [0, 1, 1]]
    """
    reach = check_reach(reach) / cells.cell
    camera = _camera(cells, field_of_view, heading)
    views = () if camera is None else camera.heading.shape[:-1]
    _check_pairs(cells, math.prod(views))
    scene = _Scene.of(cells)
    visible = np.zeros((*views, cells.positions, cells.positions), bool)
    # What a viewer may see, from its centre or, where that is fewer cells, from the origin.
    offset = _offsets(cells, reach)
    local = len(offset) < cells.positions
    place = offset if local else scene.centre
    for viewers, row, a, b in _shadows(scene, reach, len(place)):
        if local:
            target, origin = _at(cells, viewers, offset), np.zeros((len(viewers), 2))
        else:
            target = np.tile(np.arange(cells.positions), (len(viewers), 1))
            origin = scene.centre[viewers]
        target[_hidden(scene, viewers, row, a, b, target, place, origin)] = -1
        row, column = np.nonzero(target >= 0)
        viewer, target = viewers[row], target[row, column]
        part, corners = scene.parts_seen(viewer, target)
        near = _of_all(part, (np.hypot(*np.moveaxis(corners, -1, 0)) <= reach + TOLERANCE).all(-1))
        if camera is None:
            visible[viewer[near], target[near]] = True
            continue
        for view in np.ndindex(views):
            ahead = _of_all(part, camera.holds(corners, camera.heading[view][viewer[part]]))
            visible[view][viewer[near & ahead], target[near & ahead]] = True
    return visible


def visible_centres(
    cells: CellSpace, reach: float | int
) -> Bool[np.ndarray, "positions positions"]:
    """Which centres of cells are visible from which; a symmetric relation.

    The rule at walls and corners is that of a swept step: sight runs along walls and grazes
    corners, and does not pass between two obstacles that meet in a point.

    **Arguments:**

    - `cells`: the cell space.
    - `reach`: range of sight, in metres; may be infinite.

    **Returns:** `visible[i, j]`: whether the centres of `i` and `j` see each other.

    **Raises:** `ValueError` if `reach` is not more than 0; `MemoryError` where the pairs would not
    fit the free memory.

    In a corridor of three squares:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> space.visible_centres(cells, reach=1.0).astype(int).tolist()
        [[1, 1, 0], [1, 1, 1], [0, 1, 1]]
    """
    reach = check_reach(reach) / cells.cell
    # The relation, its transpose, and both together.
    _check_pairs(cells, 3)
    scene = _Scene.of(cells)
    near, wall = scene.walls_near(reach)
    lines = shapely.linestrings(scene.walls[wall, 1:])
    distance = shapely.distance(shapely.points(scene.centre[near]), lines)
    visible = np.eye(cells.positions, dtype=bool)
    # Each pair is looked at from one of its ends, the lower left one.
    offset = _offsets(cells, reach)
    offset = offset[(offset[:, 1] > 0) | ((offset[:, 1] == 0) & (offset[:, 0] > 0))]
    everybody = np.arange(cells.positions)
    lengths, same = np.unique(np.hypot(*offset.T), return_inverse=True)
    for i, length in enumerate(lengths):
        steps = offset[same == i]
        target = _at(cells, everybody, steps)
        met = distance <= length + TOLERANCE
        if met.any():
            places, blocked = meets_wall(
                scene.walls, scene.centre, steps.astype(float), near[met], wall[met]
            )
            target[places] = np.where(blocked, -1, target[places])
        viewer, step = np.nonzero(target >= 0)
        visible[viewer, target[viewer, step]] = True
    return visible | visible.T


def _check_pairs(cells: CellSpace, matrices: int) -> None:
    check(
        float(matrices) * cells.positions**2,
        f"sight between all pairs of {cells.positions:,} positions",
        "use larger cells",
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Scene:
    """What there is to see and what hides it, in units of a cell from the origin of the cells."""

    centre: Float[np.ndarray, "positions 2"]
    walls: Float[np.ndarray, "walls 3 2"]
    "Edges of the environment, as `CellSpace.walls` has those of the free space."
    part: Float[np.ndarray, "parts 4 2"]
    "Convex parts that make up what is free of the squares: the square, or triangles (closed)."
    first: Int[np.ndarray, "bounds"]
    "The parts of position `i` are `first[i]` to `first[i + 1]`."

    @classmethod
    def of(cls, cells: CellSpace) -> "_Scene":
        row, column = np.divmod(cells.square, cells.free.shape[1])
        centre = np.stack([column, row], axis=1) + 0.5
        origin, cell = np.array(cells.origin), cells.cell
        if cells.workspace is not None:
            environment = cells.workspace.environment
        else:
            origin, cell = np.zeros(2), 1.0
            environment = shapely.simplify(shapely.union_all(_squares(centre, 1.0)), 0)

        shapely.prepare(environment)
        metres = centre * cell + origin
        whole = shapely.covers(environment, _squares(metres, cell * (1 - 2 * TOLERANCE)))
        cut = np.flatnonzero(~whole)
        free = shapely.intersection(environment, _squares(metres[cut], cell))
        pieces, piece_of = polygons(free)
        triangles, of = polygons(shapely.constrained_delaunay_triangles(pieces))
        corners = shapely.get_coordinates(shapely.orient_polygons(triangles)).reshape(-1, 4, 2)

        position = np.concatenate([np.flatnonzero(whole), cut[piece_of[of]]])
        part = centre[whole, None] + [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
        part = np.concatenate([part, (corners - origin) / cell])
        order = np.argsort(position, kind="stable")
        first = np.searchsorted(position[order], np.arange(cells.positions + 1))
        walls = (edges(environment) - origin) / cell
        return cls(centre, walls, part[order], first)

    def walls_near(self, reach: float) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
        """The pairs of a position and a wall in its reach, by position."""
        tree = shapely.STRtree(shapely.linestrings(self.walls[:, 1:]))
        points = shapely.points(self.centre)
        near, wall = tree.query(points, predicate="dwithin", distance=reach + TOLERANCE)
        order = np.argsort(near, kind="stable")
        return near[order], wall[order]

    def parts_seen(
        self, viewer: Int[np.ndarray, "pairs"], target: Int[np.ndarray, "pairs"]
    ) -> tuple[Int[np.ndarray, "parts"], Float[np.ndarray, "parts 4 2"]]:
        """The parts of the target of each pair: which pair, and the corners, from the viewer."""
        count = self.first[target + 1] - self.first[target]
        pair = np.repeat(np.arange(len(target)), count)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        part = self.part[self.first[target][pair] + within]
        return pair, part - self.centre[viewer[pair], None]


def _squares(centre: Float[np.ndarray, "squares 2"], side: float) -> np.ndarray:
    return shapely.box(*(centre - side / 2).T, *(centre + side / 2).T)


def _of_all(
    part: Int[np.ndarray, "parts"], true: Bool[np.ndarray, "parts"]
) -> Bool[np.ndarray, "pairs"]:
    """What holds for each pair: that which is true of all its parts."""
    return np.logical_and.reduceat(true, np.flatnonzero(np.diff(part, prepend=-1)))


def _offsets(cells: CellSpace, reach: float) -> Int[np.ndarray, "offsets 2"]:
    """The squares whose centres are in reach, as columns and rows from that of the viewer."""
    most = [int(min(reach + TOLERANCE, size - 1)) for size in cells.free.shape]
    up, across = (x.ravel() for x in np.mgrid[tuple(slice(-m, m + 1) for m in most)])
    near = np.hypot(up, across) <= reach + TOLERANCE
    return np.stack([across[near], up[near]], axis=1)


def _at(
    cells: CellSpace, viewers: Int[np.ndarray, "viewers"], offset: Int[np.ndarray, "offsets 2"]
) -> Int[np.ndarray, "viewers offsets"]:
    """The positions at offsets from others, -1 where there is none."""
    rows, columns = cells.free.shape
    row, column = np.divmod(cells.square[viewers, None], columns)
    row, column = row + offset[:, 1], column + offset[:, 0]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return np.where(inside, cells.position_of_square[row * inside, column * inside], -1)


def _shadows(scene: _Scene, reach: float, width: int) -> Iterator[tuple]:
    """Viewers, a few at a time, and the ends of the walls in reach that they are behind.

    What an obstacle hides lies beyond a wall whose free side is the far one. (The near walls of the
    obstacle would do as well, but not where the viewer stands on one of them.) A wall whose line
    passes through the viewer hides nothing.
    """
    viewer, wall = scene.walls_near(reach)
    a, b = (scene.walls[wall, end] - scene.centre[viewer] for end in (1, 2))
    longest = np.maximum.reduce([np.hypot(*v.T) for v in (a, b, b - a)])
    behind = cross(a, b) < -TOLERANCE * longest
    viewer, a, b = viewer[behind], a[behind], b[behind]
    positions = np.arange(len(scene.centre))
    first = np.searchsorted(viewer, np.append(positions, len(positions)))
    work = np.cumsum((np.diff(first) + 1) * width)
    cuts = np.flatnonzero(np.diff(work // _CHUNK)) + 1
    for viewers in np.split(positions, cuts):
        pairs = slice(first[viewers[0]], first[viewers[-1] + 1])
        yield viewers, viewer[pairs] - viewers[0], a[pairs], b[pairs]


def _hidden(
    scene: _Scene,
    viewers: Int[np.ndarray, "viewers"],
    row: Int[np.ndarray, "shadows"],
    a: Float[np.ndarray, "shadows 2"],
    b: Float[np.ndarray, "shadows 2"],
    target: Int[np.ndarray, "viewers places"],
    place: Num[np.ndarray, "places 2"],
    origin: Float[np.ndarray, "viewers 2"],
) -> Bool[np.ndarray, "viewers places"]:
    """Whether some shadow overlaps what is free of each target.

    `row` counts the viewers, and the centre of a target lies at `place - origin` from its viewer.
    """
    hidden = np.zeros(target.shape, bool)
    if not len(row):
        return hidden
    # How deep the centre of each square lies in each shadow, and at most a corner.
    centre, corner = np.full((2, len(row), len(place)), np.inf)
    for normal, least in _sides(a, b, 1.0):
        depth = normal @ place.T - (least + np.vecdot(normal, origin[row]))[:, None]
        np.minimum(centre, depth, out=centre)
        depth += np.abs(normal).sum(axis=1, keepdims=True) / 2
        np.minimum(corner, depth, out=corner)
    # A shadow on a centre, which is free, is on something free around it.
    some, first = np.unique(row, return_index=True)
    hidden[some] = np.logical_or.reduceat(centre > TOLERANCE, first, axis=0)
    # Squares that a shadow may graze.
    shadow, at = np.nonzero((corner > TOLERANCE) & ~hidden[row] & (target[row] >= 0))
    part, corners = scene.parts_seen(viewers[row[shadow]], target[row[shadow], at])
    met = part[_overlap(corners, a[shadow][part], b[shadow][part], 1.0)]
    hidden[row[shadow[met]], at[met]] = True
    return hidden


def _sides(
    a: Float[np.ndarray, "shadows 2"], b: Float[np.ndarray, "shadows 2"], start: float
) -> Iterator[tuple[Float[np.ndarray, "shadows 2"], Float[np.ndarray, "shadows"]]]:
    """The inner unit normal of each side of a shadow, and its product with the points there.

    The shadow is `s a + t b` with `s, t >= 0` and `s + t >= start`; `a` is to the left of `b`.
    """
    for along, point in ((b, 0.0), (-a, 0.0), (b - a, start)):
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        yield normal, point * np.vecdot(normal, a)


def _overlap(
    corners: Float[np.ndarray, "parts 4 2"],
    a: Float[np.ndarray, "parts 2"],
    b: Float[np.ndarray, "parts 2"],
    start: float,
) -> Bool[np.ndarray, "parts"]:
    """Whether each convex part and its shadow overlap: no normal of a side of either parts them."""
    overlap = np.ones(len(corners), bool)
    for normal, least in _sides(a, b, start):
        overlap &= (corners @ normal[:, :, None])[..., 0].max(axis=1) - least > TOLERANCE
    edge = np.roll(corners, -1, axis=1) - corners
    most = cross(corners, edge)
    least = np.minimum(cross(a[:, None], edge), cross(b[:, None], edge))
    least = np.where(least < 0, -np.inf, start * least)
    # An edge of no length, which closes a triangle, parts nothing.
    overlap &= ~(least > most - TOLERANCE * np.hypot(*np.moveaxis(edge, -1, 0))).any(axis=1)
    return overlap


@dataclasses.dataclass(frozen=True, eq=False)
class _Camera:
    field_of_view: float
    heading: Float[np.ndarray, "*views positions"]

    def holds(
        self, corners: Float[np.ndarray, "parts 4 2"], heading: Float[np.ndarray, "parts"]
    ) -> Bool[np.ndarray, "parts"]:
        """Whether each convex part, its corners taken from the viewer, is wholly in the view."""
        right, left = (
            np.stack([np.cos(angle), np.sin(angle)], axis=1)
            for angle in (heading - self.field_of_view / 2, heading + self.field_of_view / 2)
        )
        if sees_all_around(self.field_of_view):
            return np.ones(len(corners), bool)
        if self.field_of_view > np.pi:
            # What the camera does not see is convex, and behind it as the shadow of a point.
            return ~_overlap(corners, right, left, 0.0)
        in_view = np.minimum(cross(right[:, None], corners), cross(corners, left[:, None]))
        return (in_view >= -TOLERANCE).all(axis=1)


def _camera(
    cells: CellSpace,
    field_of_view: float | int | None,
    heading: Float[np.ndarray, "..."] | float | int | None,
) -> _Camera | None:
    if (field_of_view is None) != (heading is None):
        raise ValueError(
            f"field_of_view and heading: expected both or neither, got {field_of_view!r} "
            f"and {heading!r}"
        )
    if field_of_view is None:
        return None
    field_of_view = check_view(field_of_view)
    headings = np.asarray(heading, float)
    if headings.ndim and headings.shape[-1] not in (1, cells.positions):
        raise ValueError(
            f"heading: expected a number, or a last axis of 1 or {cells.positions} (positions), "
            f"got shape {headings.shape}"
        )
    if not np.isfinite(headings).all():
        wrong = headings[~np.isfinite(headings)].flat[0]
        raise ValueError(f"heading: expected finite numbers, got {wrong}")
    return _Camera(
        field_of_view, np.broadcast_to(headings, (*headings.shape[:-1], cells.positions))
    )
