import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ...base.formatting import in_time, percent
from ...base.quantities import derived, from_part, quantity
from ...mapping import Chain
from ...markov import NearlyClosedSets, almost_invariant_sets
from ..flow import steps_in
from ..results.on_map import OnMap
from ..results.sentences import name_place
from ..water import Water
from .cell_counts import CellCounts
from .moves import squares


_YEARS_10 = 3650 * 86_400.0
# The number of times at which the distribution is known after the release.
_TIMES = 10
# A patch is denser than the release by more than this factor, and has at least this share of the
# cells: few drifters were seen in smaller ones, which are at beaches.
_DENSE, _LEAST_PATCH = 3.0, 0.001
# Smaller shares are not named.
_SEEN = 1e-6
# The least density on the map.
_FAINT = 1e-3
_of_patch = functools.partial(derived, "patch")
_share = functools.partial(derived, "", kind="share")
_DRY = "NaN: no drifter was there"
_Route = tuple[Int[np.ndarray, "_places"], Float[np.ndarray, "_places"]]


@dataclasses.dataclass(frozen=True, eq=False)
class CountedDrift(OnMap):
    """The patches and routes of drifters whose moves between cells of any shape were counted.

    Two cells, of which the second gathers nine tenths of the drifters:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> counts = np.array([[1, 9], [1, 9]])
        >>> moves = drift.CellCounts.of([0.0, 1.0], [0.0, 0.0], counts, 5.0)
        >>> found = drift.CountedDrift.of(moves, after=30 * 86400)
        >>> found.share[-1].round(6).tolist()
        [0.1, 0.9]
    """

    title: ClassVar[str] = "Drifters by counts of their moves"
    picture: ClassVar[str] = "density"
    tables: ClassVar[Mapping[str, str]] = {"patch": "patches", "set": "nearly_closed_sets"}
    brief: ClassVar[tuple[str, ...]] = (
        "moves",
        "cells",
        "step",
        "travel_time",
        "travel_time_back",
        "patch",
        "set",
    )

    counts: CellCounts
    "The moves between the cells."
    hours: Annotated[
        Float[np.ndarray, "times"], quantity("time", "time after the release", "h", kind="time")
    ]
    share: Annotated[
        Float[np.ndarray, "times cells"],
        quantity("time cell", "share of the drifters in the cell, released evenly", kind="share"),
    ]
    begun: Float[np.ndarray, "cells"]
    "The mean number of moves of a drifter that begin in each cell, until the last of the times."
    asked: float | None = None
    "The time in hours that was asked for; `None` for the last of the times."
    there: _Route | None = None
    "The cells of the most likely route, and the mean hours until they are entered."
    back: _Route | None = None
    sets: NearlyClosedSets | None = None
    "Nearly closed sets of the cells between which drifters go to and fro."
    main: Int[np.ndarray, "main"] | None = None
    "The cells of `sets`."

    @classmethod
    def of(
        cls,
        counts: CellCounts,
        *,
        after: float | int | None = None,
        source: int | None = None,
        target: int | None = None,
        sets: int | None = None,
    ) -> "CountedDrift":
        """Push drifters that are released evenly, one per cell, and find a route.

        **Arguments:**

        - `counts`: the moves.
        - `after`: the time in seconds after the release; by default ten years.
        - `source`, `target`: the cells of the route; `None` for no route.
        - `sets`: the number of nearly closed sets to find.
        """
        steps = steps_in(_YEARS_10 if after is None else after, counts.lag)
        ends = np.unique(np.linspace(0, steps, _TIMES + 1).round().astype(int))
        matrix, share = counts.chain.to_scipy(), np.full(counts.cells, 1 / counts.cells)
        push, shares, begun = matrix.T.tocsr(), [share], np.zeros(counts.cells)
        for step in range(1, steps + 1):
            begun += share
            share = push @ share
            if step in ends:
                shares.append(share)
        there = back = None
        if source is not None and target is not None:
            there, back = counts.route(source, target), counts.route(target, source)
        found = main = None
        if sets is not None:
            _, piece = csgraph.connected_components(matrix, connection="strong")
            main = np.flatnonzero(piece == np.bincount(piece).argmax())
            found = almost_invariant_sets(Chain.from_scipy(matrix[main][:, main]), sets)
        hours = ends * counts.lag / 3600
        asked = None if after is None else after / 3600
        return cls(counts, hours, np.stack(shares), begun, asked, there, back, found, main)

    @property
    def answer(self) -> tuple[str, ...]:
        held, stuck = self.patch_share.sum(), self.ended + self.stayed
        years = self.hours[-1] / (24 * 365.25)
        time = f"{years:.2g} years" if years >= 2 else in_time(self.hours[-1])
        rest = (
            f"Of all, {percent(stuck)} is where no drifter was seen to go on, such as on a beach: "
            f"{percent(self.ended)} in cells from which no move begins, {percent(self.stayed)} in "
            f"cells whose moves all stay; {percent(self.lost)} was lost in moves into no cell."
        )
        lines = [f"After {time} there is no patch.", rest]
        if held:
            patch = zip(self.patch_share, self.patch_lon, self.patch_lat, strict=True)
            named = [f"{percent(share)} around {name_place(x, y)}" for share, x, y in patch]
            patches = f"{len(named)} {'patch' if len(named) == 1 else 'patches'}"
            lines = [
                f"After {time} {percent(held)} of what was spread evenly over the sea is in "
                f"{patches}, over {_DENSE:g} times as dense as then: {', '.join(named)}.",
                rest,
            ]
        if self.asked is not None and abs(self.asked - self.hours[-1]) > _SEEN:
            lines.append(
                f"The answer is for {in_time(self.hours[-1])}, not {in_time(self.asked)}: moves "
                f"take {in_time(self.step / 3600)}."
            )
        if self.removed > _SEEN:
            lines.insert(
                0,
                f"In doubt: {percent(self.removed)} went into cells that --least leaves out, and "
                "where it is then is not known; patches are smaller by that, or missing.",
            )
        if self.there is not None and self.back is not None:
            places = [
                name_place(self.counts.lon[k], self.counts.lat[k]) for k in self.there[0][[0, -1]]
            ]
            out, home = (in_time(float(route[1][-1])) for route in (self.there, self.back))
            lines.append(
                f"From {places[0]} to {places[1]} the most likely route takes {out} on average, "
                f"and back {home}."
            )
        if self.sets is not None and self.main is not None:
            cells, lost = np.bincount(self.sets.begin[self.sets.begin >= 0]), self.sets.leakage
            least, most, time = percent(lost.min()), percent(lost.max()), in_time(self.step / 3600)
            lines.append(
                f"{self.sets.count} nearly closed sets of {cells.min():,} to {cells.max():,} cells "
                f"lose {least} to {most} in {time}."
            )
        return tuple(lines)

    @property
    def remarks(self) -> tuple[str, ...]:
        few = int((self.counts.total < 100).sum()) if self.counts.counted else 0
        if not few:
            return ()
        return (
            f"{few:,} of {self.cells:,} cells have fewer than 100 moves, so their shares are not "
            "sure; --least leaves cells out, and loses what drifts into them.",
        )

    @derived("", "moves between cells", kind="count")
    def moves(self) -> int | None:
        return int(self.counts.counts.sum()) if self.counts.counted else None

    ended = _share("drifters that moved into a cell from which no move begins")(
        lambda found: found._moved(found.counts.ended)
    )
    stayed = _share("drifters in cells whose moves all stay, outside patches")(
        lambda found: float(found.share[-1, found._still].sum())
    )
    removed = _share("drifters that moved into a cell that is left out for its few moves")(
        lambda found: found._moved(found.counts.removed)
    )

    @_share("drifters that moved into no cell of the file")
    def lost(self) -> float:
        left = 1 - float(self.share[-1].sum()) - self.ended - self.removed
        return left if left > _SEEN**2 else 0.0

    def _moved(self, moves: Float[np.ndarray, "cells"]) -> float:
        """Compute the share of the drifters that have made one of some moves."""
        return float(self.begun @ (moves / self.counts.total))

    @property
    def _still(self) -> Int[np.ndarray, "some"]:
        """The cells outside patches whose moves all stay."""
        still = np.flatnonzero(self.counts.counts.diagonal() == self.counts.total)
        return np.setdiff1d(still, np.concatenate([[-1], *self._patches]))

    cells = from_part("counts.cells", "", "cells", kind="count")
    step = from_part("counts.lag", "", "duration of a move", "s")
    source = from_part("counts.source", "", "counts of")

    @derived("", "mean time of the most likely route", "h", kind="time")
    def travel_time(self) -> float | None:
        return None if self.there is None else float(self.there[1][-1])

    @derived("", "mean time of the most likely route back", "h", kind="time")
    def travel_time_back(self) -> float | None:
        return None if self.back is None else float(self.back[1][-1])

    cell_lon = from_part("counts.lon", "cell", "longitude of the cell", "degrees_east")
    cell_lat = from_part("counts.lat", "cell", "latitude of the cell", "degrees_north")
    total = from_part("counts.total", "cell", "moves from the cell; 1 for shares")

    @functools.cached_property
    def _patches(self) -> list[Int[np.ndarray, "some"]]:
        """The cells of each patch, the one with most drifters first."""
        share, matrix = self.share[-1], self.counts.chain.to_scipy()
        dense = np.flatnonzero(share * self.cells > _DENSE)
        count, piece = csgraph.connected_components(matrix[dense][:, dense], connection="weak")
        patches = [dense[piece == k] for k in range(count)]
        large = [patch for patch in patches if patch.size >= _LEAST_PATCH * self.cells]
        return sorted(large, key=lambda patch: -float(share[patch].sum()))

    @_of_patch("share of the drifters", kind="share")
    def patch_share(self) -> Float[np.ndarray, "patches"]:
        return np.array([self.share[-1, patch].sum() for patch in self._patches])

    @functools.cached_property
    def _densest(self) -> Int[np.ndarray, "patches"]:
        return np.array([one[self.share[-1, one].argmax()] for one in self._patches], int)

    @_of_patch("longitude of its densest cell", "degrees_east")
    def patch_lon(self) -> Float[np.ndarray, "patches"]:
        return self.counts.lon[self._densest]

    @_of_patch("latitude of its densest cell", "degrees_north")
    def patch_lat(self) -> Float[np.ndarray, "patches"]:
        return self.counts.lat[self._densest]

    @_of_patch("density there, of that at the release")
    def patch_density(self) -> Float[np.ndarray, "patches"]:
        return self.share[-1, self._densest] * self.cells

    @_of_patch("cells", kind="count")
    def patch_cells(self) -> Int[np.ndarray, "patches"]:
        return np.array([patch.size for patch in self._patches], int)

    @derived("set", "share that leaves the set in a move", kind="share")
    def set_leakage(self) -> Float[np.ndarray, "sets"] | None:
        return None if self.sets is None else self.sets.leakage

    @derived("cell", "nearly closed set of the cell, -1 for none", kind="index")
    def set_of_cell(self) -> Int[np.ndarray, "cells"] | None:
        if self.sets is None:
            return None
        number = np.full(self.cells, -1, np.int32)
        number[self.main] = self.sets.begin
        return number

    @derived("place", "cell of the most likely route", kind="index")
    def route_cell(self) -> Int[np.ndarray, "places"] | None:
        return None if self.there is None else self.there[0]

    @derived("place", "mean time until the route enters it", "h", kind="time")
    def route_hours(self) -> Float[np.ndarray, "places"] | None:
        return None if self.there is None else self.there[1]

    @functools.cached_property
    def _drawn(self) -> tuple[Water, Int[np.ndarray, "squares"]]:
        """Squares half as wide as cells, to draw them on, and the cell of each square with one."""
        lon, lat = self.counts.lon, self.counts.lat
        side = 360 / np.ceil(720 / float(np.median(self.counts.spacing)))
        # Cells all round the Earth are drawn from 180 W to 180 E.
        low, high = max(-90.0, float(lat.min()) - side), min(90.0, float(lat.max()) + side)
        around = (-180.0, low, 180.0, high) if np.ptp(lon) > 180 else None
        whole = squares(self.counts, side, around)
        cell = self.counts.located(whole.lon, whole.lat)
        number = np.where(cell >= 0, np.cumsum(cell.ravel() >= 0).reshape(cell.shape) - 1, -1)
        water = dataclasses.replace(whole, number=number.astype(np.int32), land=cell < 0)
        return water, cell[cell >= 0]

    @property
    def waters(self) -> tuple[Water]:
        """The squares of the map on which cells are drawn."""
        return (self._drawn[0],)

    @property
    def on(self) -> None:
        """The time of the release, which is any."""
        return None

    coastline: ClassVar[str] = ""

    def on_squares(self, values: Any) -> np.ndarray:
        """Select the value of the cell of each square of the map."""
        return np.asarray(values)[..., self._drawn[1]]

    @derived("y x", "logarithm (base 10) of the density at the end, of that before", padding=_DRY)
    def density(self) -> Float[np.ndarray, "rows columns"]:
        times = np.maximum(self.on_squares(self.share[-1] * self.cells), _FAINT)
        return self.waters[0].on_grid(np.log10(times))
