import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float

from ...base.formatting import counted, in_time, percent
from ...base.quantities import derived, quantity
from ...currents.sphere import distances, on_sphere
from ...optimize import LargestCover, largest_cover
from ..flow import Flow
from ..positions import in_degrees
from ..released_drifters import DAY, Look, Release, release_drifters, visit_cells
from ..water import Water
from .on_map import InOneLayer
from .sentences import name_day, name_length


# The places of a cell, in cells from its middle, from which drifters are followed to choose cells.
_PLACES = (np.indices((3, 3)).reshape(2, 9) - 1) / 3
# Drifters from anywhere in each chosen cell, which show what the choice is worth.
_CHECKED = 100
_HOUR = 3600.0
# The tolerance of the bound.
_ROUNDING = 1e-9
_of_drop = functools.partial(derived, "drop")


@dataclasses.dataclass(frozen=True, eq=False)
class Dropped(InOneLayer):
    """Cells in which to drop a number of drifters, so that they visit many cells in a time.

    Two drifters for two hours in the bundled sea:

        >>> import numpy as np
        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> found = drift.Dropped.of(water, flow, np.ones(water.cells, bool), 2, 7200.0)
        >>> found.cell.size, found.chosen_by <= found.bound
        (2, True)
    """

    title: ClassVar[str] = "Where to drop drifters"
    picture: ClassVar[str] = "visit"
    tables: ClassVar[Mapping[str, str]] = {"drop": "drops"}
    brief: ClassVar[tuple[str, ...]] = ("visited", "asked", "chosen_by", "bound", "allowed")

    water: Water
    inside: Bool[np.ndarray, "cells"]
    "The mask of the cells to visit."
    allowed_cells: Bool[np.ndarray, "cells"]
    "The mask of the cells in which drifters may be dropped."
    cover: LargestCover
    "The cells of the drops, what each adds, and the bound."
    tracks: Release
    "A drifter from the middle of each cell, at the end of each day."
    checked: scipy.sparse.csr_array
    "The share of drifters from anywhere in each cell (row) that visit a cell (column)."
    checked_ends: Look
    "The places of these drifters at the end."
    hours: Annotated[
        Float[np.ndarray, "times"], quantity("time", "time after the drops", "h", kind="time")
    ]
    on: np.datetime64 | None = None
    "The time of the drops."
    region: str = "the water"
    "The cells to visit, in words."
    coastline: str = ""
    "The file of land, or an empty text for the bundled coastline."
    notices: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        inside: Bool[np.ndarray, "cells"],
        count: int,
        seconds: float,
        *,
        avoid: tuple[str, ...] = (),
        start: float = 0.0,
        seed: int = 0,
        say: Callable[..., None] = lambda *_: None,
        **about: Any,
    ) -> "Dropped":
        """Follow drifters from nine places in each cell, and choose the cells one by one.

        Each cell adds the most to the expected number of visited cells. Then other drifters, from
        anywhere in the chosen cells, show what the choice is worth.

        **Arguments:**

        - `water`, `flow`: the cells, and the flow of the same layer at all records.
        - `inside`: the cells to visit.
        - `count`: the number of drops.
        - `seconds`: the time after the drops in which cells are visited.
        - `avoid`: `"land"` to leave out cells from which one of the nine drifters strands, `"edge"`
            to leave out those from which one leaves the map.
        - `start`: the time of the drops, in seconds as in `Flow.time`.
        - `seed`, `say`: the seed of diffusion, and a function that is called with the progress.
        - further keywords: fields of the result.

        **Raises:** `ValueError` if no drop is left, or none visits a cell.
        """
        middle = np.stack([water.column, water.row]).astype(float)
        going: dict[str, Any] = {"start": start, "seed": seed, "say": say}
        points = (middle[:, :, None] + _PLACES[:, None]).reshape(2, -1)
        visited, ends = visit_cells(water, flow, points, seconds=seconds, **going)
        lost = {"land": ends.stranded, "edge": ends.cell < 0}
        allowed = np.ones(water.cells, bool)
        for one in avoid:
            allowed &= ~lost[one].reshape(water.cells, -1).any(axis=1)
        if not allowed.any():
            raise ValueError("avoid: drifters from every cell are lost; ask for a shorter time")
        cover = largest_cover(_shares(visited, _PLACES.shape[1])[:, inside], count, allowed)
        if not cover.chosen.size:
            raise ValueError("cover: no drifter from a place that is allowed visits a cell of it")
        chosen = middle[:, cover.chosen]
        days = np.append(np.arange(DAY, seconds, DAY), seconds)
        tracks = release_drifters(water, flow, chosen, times=days.tolist(), **going)
        off = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, chosen.shape[1] * _CHECKED))
        anywhere = chosen.repeat(_CHECKED, axis=1) + off
        again, checked_ends = visit_cells(water, flow, anywhere, seconds=seconds, **going)
        return cls(
            water, inside, allowed, cover, tracks, _shares(again, _CHECKED), checked_ends,
            days / _HOUR, **about,
        )  # fmt: skip

    visited = derived(
        "", "cells that the drifters visit, dropped anywhere in the cells, on average"
    )(lambda found: float(found._visit[found.inside].sum()))
    chosen_by = derived("", "the same of nine drifters from each cell, by which they were chosen")(
        lambda found: float(found.cover.gained.sum())
    )
    asked = derived("", "cells to visit", kind="count")(lambda found: int(found.inside.sum()))
    bound = derived("", "upper bound on the latter for this number of drops")(
        lambda found: min(float(found.asked), math.ceil(found.cover.bound - _ROUNDING) * 1.0)
    )
    allowed = derived("", "cells in which drifters may be dropped", kind="count")(
        lambda found: int(found.allowed_cells.sum())
    )
    cell = _of_drop("cell of the drop", kind="index")(lambda found: found.cover.chosen)
    drop_lon = _of_drop("longitude of the drop", "degrees_east")(lambda found: found._places[0][0])
    drop_lat = _of_drop("latitude", "degrees_north")(lambda found: found._places[0][1])
    gained = _of_drop("expected number of cells that no earlier drop visits")(
        lambda found: found.cover.gained
    )
    stranded = _of_drop("stranded at the end", "1", kind="share")(
        lambda found: found.checked_ends.stranded.reshape(-1, _CHECKED).mean(axis=1)
    )
    left = _of_drop("off the map at the end", "1", kind="share")(
        lambda found: (found.checked_ends.cell < 0).reshape(-1, _CHECKED).mean(axis=1)
    )
    end_lon = _of_drop("longitude at the end", "degrees_east")(lambda found: found._places[1][0])
    end_lat = _of_drop("latitude at the end", "degrees_north")(lambda found: found._places[1][1])

    end_spread = _of_drop("root mean square distance from there", "km")(
        lambda found: np.sqrt(np.mean(found._away**2, axis=1))
    )

    @derived("y x", "probability of a visit, dropped anywhere in their cells", "1", kind="share",
             padding="NaN: no water")  # fmt: skip
    def visit(self) -> Float[np.ndarray, "rows columns"]:
        return self.water.on_grid(self._visit)

    @property
    def attributes(self) -> Mapping[str, Any]:
        return {"Conventions": "CF-1.8"}

    @property
    def answer(self) -> tuple[str, ...]:
        """The cells that are visited, the bound, what is lost, and the certainty."""
        drops, begins = self.cell.size, "" if self.on is None else f" on {name_day(self.on)}"
        visit, other = ("visits", "cell") if drops == 1 else ("visit", f"{drops:,} cells")
        allowed = "" if self.allowed_cells.all() else f" of the {self.allowed:,} that are allowed"
        return (
            f"Dropped{begins}, {counted(drops, 'drifter')} {visit} {round(self.visited):,} of the "
            f"{self.asked:,} cells of {self.region} within {in_time(self.hours[-1])}, and "
            f"{_number(self.stranded)} strand, {_number(self.left)} leave the map: on average, if "
            "each is dropped anywhere in its cell.",
            "By the nine drifters from each cell that determined the choice it is "
            f"{round(self.chosen_by):,}, and for no {other}{allowed} more than {self.bound:,.0f}: "
            f"at least {percent(self.chosen_by / self.bound)} of the most.",
            "deployment.csv has the cells, and where to fetch the drifters: the median distance "
            f"from there is {name_length(float(np.median(self._away)))}. An error of the current "
            "is not included.",
        )

    @functools.cached_property
    def _visit(self) -> Float[np.ndarray, "cells"]:
        return 1 - np.prod(1 - self.checked.toarray(), axis=0)

    @functools.cached_property
    def _away(self) -> Float[np.ndarray, "drops drifters"]:
        """The distances in km of the ends of drifters from that of the one from the middle."""
        ends = in_degrees(self.water, self.checked_ends.x, self.checked_ends.y)
        place = on_sphere(self.end_lon, self.end_lat)[..., None]
        return distances(on_sphere(*ends).reshape(3, -1, _CHECKED), place) / 1000

    @functools.cached_property
    def _places(self) -> tuple[Any, Any]:
        """Longitudes and latitudes of the drops and of the ends."""
        water, ends = self.water, (self.tracks.x[-1], self.tracks.y[-1])
        begin = (on[water.row[self.cell], water.column[self.cell]] for on in (self.lon, self.lat))
        return tuple(begin), in_degrees(water, *ends)


def _shares(visited: scipy.sparse.csr_array, draws: int) -> scipy.sparse.csr_array:
    """Average the visits of each `draws` drifters, which are from one place."""
    places = visited.shape[0] // draws
    row = np.arange(visited.shape[0])
    mean = scipy.sparse.csr_array((np.full(row.size, 1 / draws), (row // draws, row)),
                                  shape=(places, row.size))  # fmt: skip
    return scipy.sparse.csr_array(mean @ visited)


def _number(shares: Float[np.ndarray, "drops"]) -> str:
    """Format the expected number of drifters that are lost."""
    total = float(shares.sum())
    return f"{total:.2g}" if total else "none"
