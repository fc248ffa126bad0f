import dataclasses
from collections.abc import Iterator

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int, Num

from ..base.memory import check
from .cells import TOLERANCE, CellSpace
from .copies import copies
from .occupancy import in_squares
from .segments import cross
from .view import check_reach
from .workspace import edges, polygons


_CHUNK = 2**20
AT_CENTRE = 1e-6
"""The value of `part` in [`visible_cells`][] for which a cell is visible if its centre is visible,
unless the ray to the centre grazes a corner."""


def visible_cells(
    cells: CellSpace, reach: float | int, *, part: float | int = 1.0
) -> Bool[np.ndarray, "positions positions"]:
    """Find the cells that are wholly visible from each centre (Alam 2018, Eq. 4.1 and Alg. 4.3).

    It runs on the host, because the walls in sight depend on the values.

    A point is visible if it is no farther than `reach` and the segment to it stays in the closed
    environment. A cell is wholly visible if all points of its square that lie in the environment
    are visible. A cell that a thin wall divides may be invisible from all cells, even from itself.

    Sight runs along walls and grazes corners. It does not pass between two obstacles that meet in a
    point. The radius of the robot is ignored, and so are shadows of less than 1e-9 of a cell.

    The result is exact for polygons of any shape. A wall hides a cell if its shadow overlaps the
    cell. Overlaps of convex polygons are found from their projections onto the normals of edges.

    **Arguments:**

    - `reach`: range of sight, in metres; may be infinite.
    - `part`: the part of a cell that must be visible, given by the side (in cells, at most 1) of a
        square around its centre; with `space.sight.AT_CENTRE`, 1e-6, a visible centre is enough.

    **Returns:** `visible[i, j]`, true if `j` is wholly visible from the centre of `i`. It takes a
    byte per pair of positions.

    **Raises:** `MemoryError` if the pairs do not fit in the free memory.

    In a corridor of three squares, the far corners of the next square are 1.58 m away:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> space.visible_cells(cells, reach=1.6).astype(int).tolist()
        [[1, 1, 0], [1, 1, 1], [0, 1, 1]]
    """
    reach = check_reach(reach) / cells.cell
    if not AT_CENTRE <= part <= 1:
        raise ValueError(f"part: expected {AT_CENTRE:g} to 1, got {part}")
    check(
        float(cells.positions) ** 2,
        f"sight between all pairs of {cells.positions:,} positions",
        "use larger cells",
    )
    scene = _Scene.of(cells, part)
    visible = np.zeros((cells.positions, cells.positions), bool)
    # The places that a viewer may see, from its centre or, if these are fewer, from the origin.
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
        pair, corners = scene.parts_seen(viewer, target)
        within = (np.hypot(*np.moveaxis(corners, -1, 0)) <= reach + TOLERANCE).all(-1)
        near = _pairs_where_all(within, pair)
        visible[viewer[near], target[near]] = True
    return visible


@dataclasses.dataclass(frozen=True, eq=False)
class _Scene:
    """The squares, and the walls that may hide them, in cells from the origin of the cell space."""

    centre: Float[np.ndarray, "positions 2"]
    walls: Float[np.ndarray, "walls 3 2"]
    "The edges of the environment, in the form of `CellSpace.walls`."
    part: Float[np.ndarray, "parts 4 2"]
    "The corners of convex parts of the free part of each square: the square itself, or triangles."
    first: Int[np.ndarray, "bounds"]
    "The parts of position `i` are `part[first[i] : first[i + 1]]`."

    @classmethod
    def of(cls, cells: CellSpace, part_of_cell: float) -> "_Scene":
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
        side = cell * part_of_cell
        whole = shapely.covers(environment, _squares(metres, side - 2 * TOLERANCE * cell))
        cut = np.flatnonzero(~whole)
        free = shapely.intersection(environment, _squares(metres[cut], side))
        pieces, piece_of = polygons(free)
        triangles, of = polygons(shapely.constrained_delaunay_triangles(pieces))
        corners = shapely.get_coordinates(shapely.orient_polygons(triangles)).reshape(-1, 4, 2)

        position = np.concatenate([np.flatnonzero(whole), cut[piece_of[of]]])
        corners_of_unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        part = centre[whole, None] + part_of_cell * corners_of_unit
        part = np.concatenate([part, (corners - origin) / cell])
        order = np.argsort(position, kind="stable")
        first = np.searchsorted(position[order], np.arange(cells.positions + 1))
        walls = in_squares(edges(environment), origin, cell)
        return cls(centre, walls, part[order], first)

    def parts_seen(
        self, viewer: Int[np.ndarray, "pairs"], target: Int[np.ndarray, "pairs"]
    ) -> tuple[Int[np.ndarray, "parts"], Float[np.ndarray, "parts 4 2"]]:
        """List the convex parts of all targets, with their corners relative to the viewer.

        The first result is the index of the pair (viewer and target) of each part.
        """
        pair, within = copies(self.first[target + 1] - self.first[target])
        part = self.part[self.first[target][pair] + within]
        return pair, part - self.centre[viewer[pair], None]


def _squares(centre: Float[np.ndarray, "squares 2"], side: float) -> np.ndarray:
    return shapely.box(*(centre - side / 2).T, *(centre + side / 2).T)


def _pairs_where_all(
    holds: Bool[np.ndarray, "parts"], pair: Int[np.ndarray, "parts"]
) -> Bool[np.ndarray, "pairs"]:
    """Return a mask of the pairs whose parts all hold; `pair` is the pair of each part, sorted."""
    return np.logical_and.reduceat(holds, np.flatnonzero(np.diff(pair, prepend=-1)))


def _offsets(cells: CellSpace, reach: float) -> Int[np.ndarray, "offsets 2"]:
    """List the squares whose centres are within `reach`, as columns and rows from the viewer."""
    most = [int(min(reach + TOLERANCE, size - 1)) for size in cells.free.shape]
    up, across = (x.ravel() for x in np.mgrid[tuple(slice(-m, m + 1) for m in most)])
    near = np.hypot(up, across) <= reach + TOLERANCE
    return np.stack([across[near], up[near]], axis=1)


def _at(
    cells: CellSpace, viewers: Int[np.ndarray, "viewers"], offset: Int[np.ndarray, "offsets 2"]
) -> Int[np.ndarray, "viewers offsets"]:
    """Find the position at each offset from each viewer; -1 if there is none."""
    rows, columns = cells.free.shape
    row, column = np.divmod(cells.square[viewers, None], columns)
    row, column = row + offset[:, 1], column + offset[:, 0]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return np.where(inside, cells.position_of_square[row * inside, column * inside], -1)


def _shadows(scene: _Scene, reach: float, width: int) -> Iterator[tuple]:
    """Yield the shadows of walls for viewers at all positions, a few viewers at a time.

    A shadow is given by the index of its viewer among these few, and by the ends of the wall that
    casts it, relative to the viewer. Only the far walls of an obstacle, whose free side faces away
    from the viewer, cast shadows, because a viewer may stand on a near wall. A wall whose line
    passes through the viewer hides nothing. `width` is the number of squares tested per viewer.
    """
    tree = shapely.STRtree(shapely.linestrings(scene.walls[:, 1:]))
    points = shapely.points(scene.centre)
    pairs = tree.query(points, predicate="dwithin", distance=reach + TOLERANCE)
    viewer, wall = pairs[:, np.argsort(pairs[0], kind="stable")]
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
    """Return a mask of the targets whose free part overlaps a shadow.

    Shadow `i` lies behind the segment from `a[i]` to `b[i]`, relative to the viewer with the index
    `v = row[i]`. For this viewer, `target[v, j]` is the position at place `j` (-1 for none), and
    `place[j] - origin[v]` is the centre of this position, relative to the viewer.
    """
    hidden = np.zeros(target.shape, bool)
    if not len(row):
        return hidden
    # The depth of the centre of each square in each shadow, and the most of a corner.
    centre, corner = np.full((2, len(row), len(place)), np.inf)
    for normal, least in _sides(a, b):
        depth = normal @ place.T - (least + np.vecdot(normal, origin[row]))[:, None]
        np.minimum(centre, depth, out=centre)
        depth += np.abs(normal).sum(axis=1, keepdims=True) / 2
        np.minimum(corner, depth, out=corner)
    # A shadow on a centre hides free points around it, because centres are free.
    viewed, first = np.unique(row, return_index=True)
    hidden[viewed] = np.logical_or.reduceat(centre > TOLERANCE, first, axis=0)
    # Squares that a shadow may graze.
    shadow, at = np.nonzero((corner > TOLERANCE) & ~hidden[row] & (target[row] >= 0))
    part, corners = scene.parts_seen(viewers[row[shadow]], target[row[shadow], at])
    met = part[_overlap(corners, a[shadow][part], b[shadow][part])]
    hidden[row[shadow[met]], at[met]] = True
    return hidden


def _sides(
    a: Float[np.ndarray, "shadows 2"], b: Float[np.ndarray, "shadows 2"]
) -> Iterator[tuple[Float[np.ndarray, "shadows 2"], Float[np.ndarray, "shadows"]]]:
    """Yield the three half planes whose intersection is a shadow.

    The shadow is `s a + t b` with `s, t >= 0` and `s + t >= 1`; `a` is to the left of `b`. Each
    half plane is `normal @ x >= least`, with a unit normal.
    """
    for along, start in ((b, 0.0), (-a, 0.0), (b - a, 1.0)):
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        yield normal, start * np.vecdot(normal, a)


def _overlap(
    corners: Float[np.ndarray, "parts 4 2"],
    a: Float[np.ndarray, "parts 2"],
    b: Float[np.ndarray, "parts 2"],
) -> Bool[np.ndarray, "parts"]:
    """Test whether each convex part of a square overlaps the shadow behind the segment `a b`."""
    overlap = np.ones(len(corners), bool)
    for normal, least in _sides(a, b):
        overlap &= (corners @ normal[:, :, None])[..., 0].max(axis=1) - least > TOLERANCE
    edge = np.roll(corners, -1, axis=1) - corners
    most = cross(corners, edge)
    least = np.minimum(cross(a[:, None], edge), cross(b[:, None], edge))
    least = np.where(least < 0, -np.inf, least)
    # An edge of no length, which closes a triangle, separates nothing.
    overlap &= ~(least > most - TOLERANCE * np.hypot(*np.moveaxis(edge, -1, 0))).any(axis=1)
    return overlap
