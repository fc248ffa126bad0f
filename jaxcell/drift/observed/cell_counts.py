"""Moves of drifters between cells of any shape, such as hexagons, and the files of their counts."""

import dataclasses
import functools
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from ...base.bundled import bundled
from ...base.shown import Shown
from ...currents.sphere import EARTH_RADIUS, on_sphere, wrapped
from ...mapping import Chain
from ...markov import most_probable_path


_DAY = 86_400.0
# Half the diagonal of a square, as a share of its side: no regular cell reaches farther.
_REACH = 0.71
# The errors of damaged archives and documents; a RuntimeError is of a form of zip that is not read.
_DAMAGE = (
    *(ValueError, OverflowError, EOFError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, ElementTree.ParseError),
)
_NS = "{http://graphml.graphdrawing.org/xmlns}"


@dataclasses.dataclass(frozen=True, eq=False)
class CellCounts(Shown):
    """Numbers of moves between cells of any shape, in a fixed time.

    Of 4 drifters in cell 0, one moves to cell 1 and one to a place in no cell; cell 1 keeps its 2:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> moves = drift.CellCounts.of([0.0, 1.0], [0.0, 0.0], [[2, 1], [0, 2]], 5.0, lost=[1, 0])
        >>> moves.chain.to_scipy().toarray().tolist()
        [[0.5, 0.25], [0.0, 1.0]]
    """

    lon: Float[np.ndarray, "cells"]
    "Longitudes of the centres in degrees, from -180 to 180."
    lat: Float[np.ndarray, "cells"]
    counts: scipy.sparse.csr_array
    "The number or the share of the moves from each cell (row) to each cell (column)."
    total: Float[np.ndarray, "cells"]
    "The number of all moves from each cell, also of those into no cell; 1 for shares."
    lag: float | int
    "The duration of each move, in seconds."
    ended: Float[np.ndarray, "cells"]
    "The moves from each cell into cells from which no move begins."
    removed: Float[np.ndarray, "cells"]
    "The moves from each cell into cells that are left out for their few moves."
    source: str = "counts"
    "The name of the file."

    @classmethod
    def of(
        cls,
        lon: npt.ArrayLike,
        lat: npt.ArrayLike,
        moves: Any,
        days: float | int,
        *,
        lost: npt.ArrayLike | float = 0.0,
        least: float | int = 1,
        source: str = "counts",
    ) -> "CellCounts":
        """Check counts, and leave out the cells from which too few moves begin.

        **Arguments:**

        - `lon`, `lat`: the centres of the cells in degrees.
        - `moves`: a matrix, dense or sparse. Row `i` has the numbers of the moves from cell `i` to
            each cell, or, if the matrix has floats, their shares.
        - `days`: the duration of a move.
        - `lost`: the number of moves from each cell into no cell.
        - `least`: the least number of moves from a cell. Moves to cells that are left out are moves
            into no cell.
        - `source`: the name of the file.
        """
        x, y, gone = np.array(np.broadcast_arrays(lon, lat, lost), float)
        matrix = scipy.sparse.csr_array(moves)
        if x.ndim != 1 or matrix.shape != (x.size, x.size):
            raise ValueError(f"expected {x.size:,} rows and columns, got {matrix.shape}")
        if not (np.isfinite(x).all() and (np.abs(y) <= 90).all() and 0 < days < np.inf):
            raise ValueError("expected positions in degrees, and moves of more than 0 days")
        if not (
            np.isfinite(matrix.data).all() and min(matrix.data.min(initial=0), gone.min()) >= 0
        ):
            raise ValueError("expected counts of moves or shares, 0 or more")
        shares, matrix = matrix.dtype.kind == "f", matrix.astype(float)
        total = matrix.sum(axis=1) + gone
        if shares and total.max() > 1 + 1e-6:
            raise ValueError(f"expected shares with sums of at most 1, got {total.max():g}")
        few = (total > 0) & (total < (0 if shares else least))
        kept = np.flatnonzero((total > 0) & ~few)
        if kept.size < 2:
            raise ValueError(f"expected 2 cells or more with {least:g} moves or more")
        total = np.maximum(total, 1) if shares else total
        rows, empty = matrix[kept], matrix.sum(axis=1) + gone == 0
        ended, removed = (rows[:, mask].sum(axis=1) for mask in (empty, few))
        moved, seconds = rows[:, kept], days * _DAY
        lon = wrapped(x[kept])
        return cls(lon, y[kept], moved, total[kept], seconds, ended, removed, source)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.lon.size

    @property
    def counted(self) -> bool:
        """True if moves are counted; false if only their shares are known."""
        return bool((self.total != 1).any())

    @functools.cached_property
    def chain(self) -> Chain:
        """The chain of the shares of moves; moves into no cell go to the sink."""
        return Chain.from_scipy(scipy.sparse.diags_array(1 / self.total) @ self.counts)

    @functools.cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(on_sphere(self.lon, self.lat).T)

    @functools.cached_property
    def spacing(self) -> Float[np.ndarray, "cells"]:
        """The distance in degrees from each centre to the nearest other centre."""
        chord, _ = self._tree.query(self._tree.data, 2)
        return np.degrees(2 * np.arcsin(chord[:, 1] / 2))

    def located(
        self, lon: Float[np.ndarray, "*points"], lat: Float[np.ndarray, "*points"]
    ) -> Int[np.ndarray, "*points"]:
        """Find the cell whose centre is nearest to each point; -1 farther than cells reach."""
        chord, nearest = self._tree.query(np.moveaxis(on_sphere(lon, lat), 0, -1))
        away = np.degrees(2 * np.arcsin(chord / 2))
        return np.where(away <= _REACH * self.spacing[nearest], nearest, -1)

    def cell(self, lon: float | int, lat: float | int) -> int:
        """Find the cell at a place in degrees. **Raises:** `ValueError` if it is in no cell."""
        place = np.array([[lon], [lat]], float)
        (cell,) = self.located(*place).tolist()
        if cell < 0:
            (chord,), (near,) = self._tree.query(on_sphere(*place).T)
            raise ValueError(
                f"no drifter was at ({lon:g}, {lat:g}); the nearest cell is "
                f"{2 * EARTH_RADIUS / 1000 * np.arcsin(chord / 2):.3g} km away, at "
                f"({self.lon[near]:g}, {self.lat[near]:g})"
            )
        return int(cell)

    def route(self, source: int, target: int) -> tuple[Int[np.ndarray, "places"], np.ndarray]:
        """Find the most likely sequence of cells from one cell to another, and its mean times.

        Moves that stay in a cell are no part of the sequence: the probability of a step is that of
        the next other cell. The mean time in a cell is `lag / (1 - p)`, with
        `p` the probability of a move that stays.

        **Returns:** the cells, and the mean hours until each of them is entered. **Raises:**
        `ValueError` if no sequence of moves leads from the source to the target.

        Three cells in a row, each of which a drifter leaves in one move of two:

            >>> import numpy as np
            >>> from jaxcell import drift
            >>> counts = np.array([[5, 5, 0], [0, 5, 5], [1, 0, 1]])
            >>> moves = drift.CellCounts.of([0.0, 1.0, 2.0], [0.0, 0.0, 0.0], counts, 5.0)
            >>> cells, hours = moves.route(0, 2)
            >>> cells.tolist(), (hours / 24).tolist()
            ([0, 1, 2], [0.0, 10.0, 20.0])
        """
        matrix = self.chain.to_scipy().copy()
        going = 1 - matrix.diagonal()
        matrix.setdiag(0)
        matrix.eliminate_zeros()
        per_move = scipy.sparse.diags_array(1 / np.where(going > 0, going, 1))
        cells, _ = most_probable_path(Chain.from_scipy(per_move @ matrix), source, target)
        hours = self.lag / 3600 / going[cells[:-1]]
        return cells, np.append(0.0, np.cumsum(hours))


def open_counts(path: str | os.PathLike[str], least: float | int = 1) -> CellCounts:
    """Read the numbers, or the shares, of moves between cells of any shape.

    A file `.npz` has the arrays `lon`, `lat` (degrees), `days` (the duration of a move), and the
    matrix as `data`, `indices` and `indptr` of `scipy.sparse.csr_array`: whole numbers are counts,
    floats shares. `lost` has the number of moves from each cell into no cell. In GraphML, nodes
    have `lon` and `lat`, or a `name` that is an H3 index of level 3 in the sea; edges have counts
    `N` or shares `prob`, and the graph has `day_cut_off`, as driftmlp writes them.

    **Arguments:** the file, and the least number of moves from a cell. **Returns:** the counts of
    the cells that have this number.

    The drifters of forty years:

        >>> from jaxcell import bundled, drift
        >>> drift.open_counts(bundled("gdp")).cells
        28965
    """
    name = os.path.basename(path)
    try:
        read = _graphml(path) if Path(path).suffix.lower() == ".graphml" else _npz(path)
        return CellCounts.of(**read, least=least, source=name)
    except KeyError as error:
        raise ValueError(f"{name}: expected {error.args[0]}, and found none") from None
    except _DAMAGE as error:
        raise ValueError(f"{name}: {error}") from None


def _npz(path: str | os.PathLike[str]) -> dict[str, Any]:
    with open(path, "rb") as stream, np.load(stream) as file:
        arrays = {name: file[name] for name in file}
    lon, days = arrays["lon"], float(arrays["days"].item())
    # Indices may have 16 bits.
    parts = arrays["data"], arrays["indices"].astype(np.int32), arrays["indptr"].astype(np.int32)
    moves = scipy.sparse.csr_array(parts, (lon.size, lon.size))
    moves.check_format()
    lost = arrays.get("lost", 0.0)
    return {"lon": lon, "lat": arrays["lat"], "days": days, "moves": moves, "lost": lost}


def _graphml(path: str | os.PathLike[str]) -> dict[str, Any]:
    keys: dict[str, str] = {}
    nodes: dict[str, tuple[int, dict[str, str]]] = {}
    edges: list[tuple[str, str, dict[str, str]]] = []
    graph: dict[str, str] = {}
    for _, element in ElementTree.iterparse(path):
        kind = element.tag.removeprefix(_NS)
        if kind == "key":
            keys[element.attrib["id"]] = element.attrib["attr.name"]
        elif kind in ("node", "edge", "graph"):
            about = {
                keys[one.attrib["key"]]: one.text or "" for one in element.findall(f"{_NS}data")
            }
            if kind == "node":
                nodes[element.attrib["id"]] = len(nodes), about
            elif kind == "edge":
                edges.append((element.attrib["source"], element.attrib["target"], about))
            else:
                graph = about
            element.clear()
    ends = np.array([(nodes[s][0], nodes[t][0]) for s, t, _ in edges], int).reshape(-1, 2).T
    lon, lat = _positions([about for _, about in nodes.values()])
    counted = all("N" in about for *_, about in edges)
    value = np.array([float(about["N" if counted else "prob"]) for *_, about in edges])
    moves, lost = scipy.sparse.csr_array((value, ends), (lon.size, lon.size)), np.zeros(lon.size)
    if counted and all("prob" in about for *_, about in edges):
        # Moves into cells that are no nodes are in the shares only.
        lost[ends[0]] = np.rint(value / np.array([float(about["prob"]) for *_, about in edges]))
        lost = np.maximum(lost - moves.sum(axis=1), 0)
    moves = moves.astype(np.int64) if counted else moves
    days = float(graph["day_cut_off"])
    return {"lon": lon, "lat": lat, "days": days, "moves": moves, "lost": lost}


def _positions(nodes: list[dict[str, str]]) -> Float[np.ndarray, "2 nodes"]:
    """Return the longitudes and latitudes of nodes, from their data or from their H3 index."""
    if all("lon" in node and "lat" in node for node in nodes):
        return np.array([[float(node[name]) for node in nodes] for name in ("lon", "lat")])
    with np.load(bundled("gdp")) as known:
        index = np.array([int(node["name"]) for node in nodes], np.uint64)
        at = np.searchsorted(known["h3"], index).clip(0, known["h3"].size - 1)
        if (missing := known["h3"][at] != index).any():
            raise ValueError(
                f"node {index[missing.argmax()]}: expected lon and lat, or the H3 index of a cell "
                "of level 3 in the sea"
            )
        return np.stack([known["lon"][at], known["lat"][at]]).astype(float)
