"""Morse sets from adaptive subdivision, and their order."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from ...base.formatting import counted, percent
from ...base.indices import check_whole
from ...base.quantities import derived, from_part, quantity
from ...space.box import Box
from ..imaging import OnBox, Say, check_begin, check_map
from ..maps import Map
from .grid import Grid
from .images import Intervals, OuterMap
from .order import reachable, recurrent_components


# Largest number of cells of a picture.
_DRAWN = 1 << 18


@dataclasses.dataclass(frozen=True)
class MorseCertificate:
    """Proved statements about Morse sets, and the numbers of boxes and edges in the proof."""

    proof: str
    "The reason why outer images contain the images of all points; empty without a proof."
    mapped: int
    "Number of boxes whose images were computed."
    edges: int
    "Number of pairs of boxes such that the second touches the image of the first."

    @property
    def proved(self) -> bool:
        """`True` if outer images are proved to contain the images of all points."""
        return bool(self.proof)

    @property
    def statement(self) -> str:
        """The proved statements, as text."""
        if not self.proved:
            return "Nothing is proved: images of boxes are boxes around images of some points."
        return (
            "Proved: these sets contain all chain recurrent points whose orbits stay in the box, "
            "and orbits lead from one set to another only if the order says so "
            f"({self.proof}, of {self.mapped:,} boxes)."
        )


@dataclasses.dataclass(frozen=True, eq=False)
class MorseSets(OnBox):
    """Sets of boxes that contain all recurrent points of a map, and their order (`leads`)."""

    title: ClassVar[str] = "Morse sets"
    tables: ClassVar[Mapping[str, str]] = {"set": "sets"}
    picture: ClassVar[str] = "drawn"

    box: Box
    "The box. Its cells, used only in pictures, are the initial ones bisected into at most 262,144."
    params: Any
    "The parameters of the map."
    lower: Annotated[
        Float[np.ndarray, "boxes axes"], quantity("box axis", "lower corner of the box")
    ]
    upper: Annotated[
        Float[np.ndarray, "boxes axes"], quantity("box axis", "upper corner of the box")
    ]
    member: Annotated[
        Int[np.ndarray, "boxes"], quantity("box", "Morse set of the box", kind="index")
    ]
    leads: Annotated[
        Bool[np.ndarray, "sets sets"],
        quantity("set other", "whether boxes lead from the set to the other one", kind="flag"),
    ]
    "`True` at `[i, j]` if a path of boxes leads from set `i` to set `j`: transitive, with `j < i`."
    certificate: MorseCertificate
    labels: tuple[str, ...] = ()
    "The names of the axes. Without names, the axes are called `x0`, `x1`, ..."

    @property
    def answer(self) -> tuple[str, ...]:
        sets, share = counted(self.sets, "Morse set"), percent(self.share.sum())
        fill = f"{sets} with {share} of the box" if self.sets else "no set"
        return (f"The recurrent points whose orbits stay in the box are in {fill}.",)

    @derived("", "number of Morse sets", kind="count")
    def sets(self) -> int:
        return len(self.leads)

    @derived("set", "boxes of the set", kind="count")
    def boxes(self) -> Int[np.ndarray, "sets"]:
        return np.bincount(self.member, minlength=self.sets)

    @derived("set", "volume of the set in the box", kind="share")
    def share(self) -> Float[np.ndarray, "sets"]:
        length = np.array(self.box.upper) - np.array(self.box.lower)
        volume = ((self.upper - self.lower) / length).prod(axis=1)
        return np.bincount(self.member, volume, self.sets)

    @derived("set axis", "lowest coordinates of the set", listed=True)
    def lowest(self) -> Float[np.ndarray, "sets axes"]:
        lowest = np.full((self.sets, self.box.dimensions), np.inf)
        np.minimum.at(lowest, self.member, self.lower)
        return lowest

    @derived("set axis", "highest coordinates of the set", listed=True)
    def highest(self) -> Float[np.ndarray, "sets axes"]:
        highest = np.full((self.sets, self.box.dimensions), -np.inf)
        np.maximum.at(highest, self.member, self.upper)
        return highest

    @derived("set next", "sets that follow it in the order", kind="index", listed=True)
    def leads_to(self) -> Int[np.ndarray, "sets next"]:
        """The sets to which each set leads without another set between; rows are padded with -1."""
        leads = self.leads.astype(np.int32)
        direct = self.leads & (leads @ leads == 0)
        following = np.full((self.sets, max(1, direct.sum(axis=1, initial=0).max(initial=0))), -1)
        for number, row in enumerate(direct):
            following[number, : row.sum()] = np.flatnonzero(row)
        return following

    @derived("cell", "Morse set in the cell, -1 for none", kind="index")
    def drawn(self) -> Int[np.ndarray, "cells"]:
        drawn = np.full(self.box.size, -1, np.int32)
        np.maximum.at(drawn, self.box.index(self.lower / 2 + self.upper / 2), self.member)
        return drawn

    proved = from_part(
        "certificate.proved", "", "whether images contain all images of points", kind="flag"
    )

    @property
    def remarks(self) -> tuple[str, ...]:
        return (self.certificate.statement,)


def morse_sets(
    map: Map | OuterMap,
    box: Box,
    params: Any = None,
    *,
    depth: int = 0,
    check: int = 0,
    limit: int = 10_000,
    labels: tuple[str, ...] = (),
    say: Say | None = None,
) -> MorseSets:
    """Find the recurrent sets of a map in a box, and the order in which orbits visit them.

    It runs on the host, because the number of boxes depends on the parameters.

    The image of a box is a box that contains the image of every point. A box leads to the boxes
    that touch its image. A Morse set is a maximal set of boxes that all lead to each other. Boxes
    on no cycle are dropped, the other boxes are bisected along one axis, and so on (Dellnitz &
    Hohmann 1997; Arai et al. 2009). The sets contain all chain recurrent points whose orbits stay
    in the box.

    **Arguments:**

    - `map`: a [`Map`][jaxcell.dynamics.Map], for which [`Intervals`][jaxcell.dynamics.Intervals]
        computes proved images of boxes; or another method that computes them,
        [`Corners`][jaxcell.dynamics.Corners] or [`Samples`][jaxcell.dynamics.Samples].
    - `box`: the box, with its initial cells.
    - `params`: the parameters of the map.
    - `depth`: number of bisections, along each axis in turn.
    - `check`: number of further bisections that test the sets. A set in which no cycle remains is
        left out, because it contains no recurrent point.
    - `limit`: number of boxes above which a set is kept without further tests.
    - `labels`: names of the axes.
    - `say`: a function that is called with the activity and its progress.

    **Returns:** [`MorseSets`][jaxcell.dynamics.MorseSets], beginning with the sets that lead to no
    other set.

    A saddle in the middle leads to both ends:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[7], axes="clamp")
        >>> sets = dynamics.morse_sets(lambda x, p: 4 * x - 1.5, box, depth=3)
        >>> sets.boxes.tolist(), sets.leads_to.tolist(), sets.proved
        ([1, 1, 2], [[-1, -1], [-1, -1], [0, 1]], True)
    """
    outer = map if isinstance(map, OuterMap) else Intervals(map)
    if isinstance(inner := getattr(outer, "map", None), Map):
        check_map(inner, box, params)
        check_begin(inner, box, params)
    depth, check, limit = (
        check_whole("depth", depth),
        check_whole("check", check),
        check_whole("limit", limit),
    )
    search = _Search(outer, box, params)
    cells: np.ndarray = np.arange(box.size)
    component: np.ndarray = np.zeros(box.size, np.int64)
    levels: list[_Level] = []
    for bisections in range(depth + 1):
        if say is not None:
            say("bisecting boxes", bisections, depth + check)
        if levels:
            on = levels[-1].member >= 0
            own = levels[-1].member[on]
            cells, component = search.halved(bisections - 1, cells[on], own)
        levels.append(search.level(bisections, cells, component))
    member, count = levels[-1].member, len(levels[-1].parent)
    on = member >= 0
    cells, member = cells[on], member[on]
    kept = np.zeros(count, bool)
    parts: tuple[np.ndarray, ...] = cells, member, member
    for bisections in range(depth + 1, depth + check + 1):
        if say is not None:
            say("testing sets", bisections, depth + check)
        parts = search.halved(bisections - 1, *parts)
        _, component, whole = parts
        kept[whole[np.bincount(component)[component] > limit]] = True
        parts = tuple(x[~kept[whole]] for x in parts)
        if not parts[0].size:
            break
        component = search.level(bisections, *parts[:2]).member
        parts = tuple(x[component >= 0] for x in (parts[0], component, parts[2]))
    kept[parts[2]] = True
    leads = _order(levels, np.flatnonzero(kept))
    # Sets that lead to fewer sets come first, then sets whose first box comes first.
    first: np.ndarray = np.full(count, cells.size)
    np.minimum.at(first, member, np.arange(cells.size))
    order = np.lexsort((first[kept], leads.sum(axis=1)))
    names = np.full(count, -1)
    names[np.flatnonzero(kept)[order]] = np.arange(order.size)
    member = names[member]
    lower, upper = Grid(box, depth).corners(cells[member >= 0])
    return MorseSets(
        box=_picture(box, depth),
        params=params,
        lower=lower,
        upper=upper,
        member=member[member >= 0],
        leads=leads[np.ix_(order, order)],
        certificate=MorseCertificate(outer.proof, search.mapped, search.edges),
        labels=labels,
    )


class _Level(NamedTuple):
    """The boxes after a number of bisections, and the recurrent components of their graph."""

    graph: csr_array
    member: Int[np.ndarray, "boxes"]
    "The component that contains each box, -1 if the box is on no cycle."
    parent: Int[np.ndarray, "components"]
    "The component of the previous level that contains each component."


@dataclasses.dataclass
class _Search:
    outer: OuterMap
    box: Box
    params: Any
    mapped: int = 0
    edges: int = 0

    def level(
        self, bisections: int, cells: Int[np.ndarray, "boxes"], component: Int[np.ndarray, "boxes"]
    ) -> _Level:
        """Map the boxes `cells`, and find the recurrent components inside each `component`."""
        grid = Grid(self.box, bisections)
        images = self.outer.images(*grid.corners(cells), self.params)
        graph = _within_components(grid.graph(cells, *grid.blocks(*images)), component)
        self.mapped, self.edges = self.mapped + cells.size, self.edges + graph.nnz
        member = recurrent_components(graph)
        parent = np.zeros(member.max(initial=-1) + 1, np.int64)
        parent[member[member >= 0]] = component[member >= 0]
        return _Level(graph, member, parent)

    def halved(
        self, bisections: int, cells: Int[np.ndarray, "boxes"], *others: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Halve boxes; `cells` are their numbers after `bisections` bisections.

        Returns the sorted numbers of the halves, and the arrays `others`, in which the entry of
        each box is repeated for both of its halves.
        """
        halves = Grid(self.box, bisections).halves(cells)
        order = np.argsort(halves)
        return halves[order], *(np.repeat(x, 2)[order] for x in others)


def _within_components(graph: csr_array, component: Int[np.ndarray, "boxes"]) -> csr_array:
    rows = np.repeat(component, np.diff(graph.indptr))
    inside = rows == component[graph.indices]
    if inside.all():
        return graph
    before = np.concatenate([[0], np.cumsum(inside)])
    indptr = before[graph.indptr].astype(graph.indptr.dtype)
    return csr_array((graph.data[inside], graph.indices[inside], indptr), shape=graph.shape)


def _order(levels: list[_Level], sets: Int[np.ndarray, "sets"]) -> Bool[np.ndarray, "sets sets"]:
    """Find all pairs of sets `i` and `j` of the last level such that `i` leads to `j`.

    A pair is decided at the first level where the two sets are in different components.
    """
    leads = np.zeros((sets.size, sets.size), bool)
    here = sets
    for level in reversed(levels):
        above = level.parent[here]
        names, number = np.unique(here, return_inverse=True)
        apart = (here[:, None] != here) & (above[:, None] == above)
        if apart.any():
            known = np.full(len(level.parent) + 1, -1)
            known[names] = np.arange(names.size)
            paths = reachable(level.graph, known[level.member], names.size)
            leads |= apart & paths[np.ix_(number, number)]
        here = above
    return leads


def _picture(box: Box, depth: int) -> Box:
    """Bisect the cells of the box `depth` times, or less if there would be over `_DRAWN` cells."""
    grids = (Grid(box, bisections).counts for bisections in range(depth, 0, -1))
    counts = next((n for n in grids if np.prod(n, dtype=float) <= _DRAWN), box.cells)
    return Box(box.lower, box.upper, counts, box.axes)
