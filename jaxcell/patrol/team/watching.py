"""Short closed tours from which robots see all cells of a map."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Float, Int

from ...optimize import Graph, greedy_cover
from ...optimize.tour import good_order, improved_order, tour_length


# Number of random changes of a tour, on small maps and divided by the number of cells, and the
# largest number of stops that a change removes.
_CHANGES, _WORK, _REMOVED = 150, 60_000, 4


class _Map(NamedTuple):
    visible: Bool[np.ndarray, "cells cells"]
    between: Float[np.ndarray, "cells cells"]
    before: Int[np.ndarray, "cells cells"]
    wanted: Bool[np.ndarray, "cells"]
    "The cells that can be seen."

    def walk(self, stops: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
        """Return all cells on the shortest ways between stops, and back to the first."""
        cells = []
        for here, there in zip(stops.tolist(), np.roll(stops, -1).tolist(), strict=True):
            leg = [there]
            while leg[-1] != here:
                leg.append(int(self.before[here, leg[-1]]))
            cells += leg[:0:-1]
        return np.array(cells or stops)

    def missing(self, stops: Int[np.ndarray, "_"]) -> Bool[np.ndarray, "cells"]:
        """Return which cells no robot on the walk through the stops sees."""
        if not stops.size:
            return self.wanted
        return self.wanted & ~self.visible[self.walk(stops)].any(axis=0)

    def added(
        self, stops: Int[np.ndarray, "_"]
    ) -> tuple[Float[np.ndarray, "cells"], Int[np.ndarray, "cells"]]:
        """Compute how much longer a tour becomes with each cell, and the best place for it."""
        there = np.roll(stops, -1)
        longer = self.between[stops] + self.between[there] - self.between[stops, there][:, None]
        return longer.min(axis=0), longer.argmin(axis=0) + 1

    def completed(self, stops: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
        """Add stops until all cells are seen, each time with most new cells per added length."""
        while (missing := self.missing(stops)).any():
            new = self.visible[:, missing].sum(axis=1)
            if not stops.size:
                stops = np.array([int(new.argmax())])
                continue
            longer, place = self.added(stops)
            cell = int((new / (longer + 0.5)).argmax())
            stops = np.insert(stops, place[cell], cell)
        return stops

    def shortened(self, stops: Int[np.ndarray, "_"]) -> Int[np.ndarray, "_"]:
        """Remove or replace single stops while this makes the tour shorter."""
        since = 0
        while since < stops.size and stops.size > 2:
            since += 1
            stops, rest = np.roll(stops, -1), stops[1:]
            missing = self.missing(rest)
            if missing.any():
                longer, place = self.added(rest)
                cell = int(np.where(self.visible[:, missing].all(axis=1), longer, np.inf).argmin())
                rest = np.insert(rest, place[cell], cell)
            rest = improved_order(rest, self.between)
            shorter = tour_length(rest, self.between) < tour_length(stops, self.between)
            if shorter and not self.missing(rest).any():
                stops, since = rest, 0
        return stops


def watching_tours(
    graph: Graph, visible: Bool[np.ndarray, "cells cells"], covers: int
) -> Iterator[Int[np.ndarray, "_"]]:
    """Find short closed walks from which all cells are seen that can be seen.

    A tour through a greedy cover loses stops, or gets others, while it becomes shorter; then some
    stops are removed at random, and others added. **Yields:** the cells of each walk in order, from
    `covers` covers, as long as walks become shorter. There are none where a cell sees all.
    """
    lengths = graph.matrix(np.ones(len(graph.edges)))
    between, before = scipy.sparse.csgraph.shortest_path(
        lengths, unweighted=True, return_predecessors=True
    )
    wanted, random = np.asarray(visible.any(axis=0)), np.random.default_rng(0)
    room = _Map(visible, between, before, wanted)
    for choice in range(covers):
        cover = greedy_cover(visible, choice).chosen.astype(np.int64)
        if cover.size < 2:
            return
        best = cover[good_order(between[np.ix_(cover, cover)])]
        yield room.walk(best)
        best = room.shortened(best)
        yield room.walk(best)
        for _ in range(min(_CHANGES, _WORK // graph.vertices)):
            least = tour_length(best, between)
            left = max(1, best.size - int(random.integers(1, _REMOVED + 1)))
            kept = np.sort(random.choice(best.size, left, replace=False))
            changed = room.shortened(improved_order(room.completed(best[kept]), between))
            if changed.size > 1 and tour_length(changed, between) <= least:
                best = changed
                yield room.walk(best)
