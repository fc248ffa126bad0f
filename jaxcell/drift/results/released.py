import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.formatting import counted, in_time, percent
from ...base.intervals import clopper_pearson
from ...base.process import stoppable
from ...base.quantities import derived, quantity
from ...currents.sphere import distances, on_sphere
from ..flow import Flow
from ..positions import in_degrees
from ..released_drifters import Area, Release, likely, push_release, release_drifters
from ..sources import find_sources
from ..validation.simulated_drifters import total_variation
from ..water import Water, square
from .on_map import InOneLayer
from .sentences import name_day, name_length, name_place


_DRY = "NaN: no water"
_QUANTILES = (0.1, 0.5, 0.9)
# Stretches of coast are the cells at a coast in blocks of this number of rows and columns.
_BLOCK = 6
# The chain may be used if it has at most this share in a wrong cell.
_CLOSE = 0.1
_at = functools.partial(derived, "time")
_on_map = functools.partial(derived, "time y x", units="1", kind="share", padding=_DRY)
_of_region = functools.partial(derived, "region")
_of_stretch = functools.partial(derived, "stretch")


@dataclasses.dataclass(frozen=True, eq=False)
class Released(InOneLayer):
    """The places of drifters from one release at some times, with exact intervals, and the chain.

    Two hours in the bundled sea, from the middle of cell 100:

        >>> import numpy as np
        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> here = np.arange(water.cells) == 100
        >>> points = np.stack([water.column[here], water.row[here]]).repeat(50, axis=1) * 1.0
        >>> found = drift.Released.of(water, flow, points, [3600.0, 7200.0])
        >>> found.hours.tolist(), found.left.tolist()
        ([1.0, 2.0], [0.0, 0.0])
    """

    title: ClassVar[str] = "Drifters of one release"
    picture: ClassVar[str] = "share"
    tables: ClassVar[Mapping[str, str]] = {
        "time": "times",
        "region": "arrivals",
        "stretch": "coast",
        "start": "starts",
    }
    brief: ClassVar[tuple[str, ...]] = ("released", "precision", "region", "stretch")

    water: Water
    hours: Annotated[
        Float[np.ndarray, "times"],
        quantity("time", "time after the release, or before the find", "h", kind="time"),
    ]
    names: Annotated[np.ndarray, quantity("region", "place of arrival", kind="text")]
    drifters: Release
    "The simulated drifters."
    by_chain: Float[np.ndarray, "times cells"]
    "The share in each cell by the chain of cells, whose steps are from time to time."
    place: tuple[float, float]
    "Longitude and latitude of the mean of the release, or of the find."
    starts: Float[np.ndarray, "starts"] = dataclasses.field(default_factory=lambda: np.zeros(1))
    "The hours from the first release to each; each has as many of the drifters, one after another."
    tried: Annotated[
        int | None, quantity("", "drifters released in all the water", kind="count")
    ] = None
    """The number of drifters that were released in all the water, of which `drifters` were found at
    a place, if times run back from there; `None` for a release."""
    on: np.datetime64 | None = None
    "The time of the first release, or of the find."
    around: str = "in the given points"
    "The place of the release, in words."
    source: str = ""
    "The files of the currents."
    coastline: str = ""
    "The file of land, or an empty text for the bundled coastline."
    notices: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        water: Water,
        flow: Flow,
        points: Float[np.ndarray, "2 drifters"],
        times: Sequence[float],
        *,
        starts: Sequence[float] = (0.0,),
        found: Area | None = None,
        regions: tuple[np.ndarray, np.ndarray] | None = None,
        afloat: float = np.inf,
        stranded: float = np.inf,
        seed: int = 0,
        say: Callable[..., None] = lambda *_: None,
        **about: Any,
    ) -> "Released":
        """Simulate the drifters of a release or of a find, and compute the same by the chain.

        **Arguments:**

        - `water`, `flow`: the cells, and the flow of the same layer at all records.
        - `points`: the columns and rows of the grid at which drifters are released; the number of
            starts divides their number, and each start has the next part of them.
        - `times`: the times of the answer after the release, in seconds, ascending.
        - `starts`: the times of the release, in seconds as in `Flow.time`.
        - `found`: the place of a find, whose only time is in `starts`, and uniform `points` in it,
            as many as are to be found; `times` are before it, as for `find_sources`.
        - `regions`: names, and polygons of shapely in degrees, to arrive at, beside the coast.
        - `afloat`, `stranded`: half-lives in seconds at a coast and on a beach, as for
            [`jaxcell.drift.beaching`][]; by default drifters do not strand.
        - `seed`, `say`: the seed of diffusion, and a function that is called with the progress.
        - further keywords: fields of the result.
        """
        names, polygons = (np.zeros(0, str), np.zeros(0, object)) if regions is None else regions
        names = np.array([*names, "a square at the coast"])
        more: Any = {"afloat": afloat, "stranded": stranded}
        begin, _ = water.at(*square(*points))
        share = np.bincount(begin, minlength=water.cells) / begin.size
        parts: list[Release] = []
        place, hours = water.centre(share), np.array(times, float) / 3600
        if found is not None:
            drifters, by_chain, about["tried"] = find_sources(
                water, flow, found, points, starts[0], times, polygons, seed=seed, say=say, **more
            )
        else:
            for number, start in enumerate(starts):
                part, options = np.split(points, len(starts), axis=1)[number], more
                if len(starts) == 1:
                    options = {"say": say, **more}
                say(f"following {counted(len(starts), 'release')}", number, len(starts))
                with stoppable(lambda: parts):
                    one = seed + number
                    parts.append(
                        release_drifters(
                            water, flow, part, start, times, polygons, seed=one, **options
                        )
                    )
                if len(parts) == number or len(parts[-1].x) < len(times):
                    break
            parts = [part for part in parts if len(part.x) == len(times)] or parts
            drifters, starts = _joined(parts), starts[: len(parts)]
            by_chain = push_release(water, flow, share, starts, times[: len(drifters.x)], more, say)
            about["starts"] = (np.array(starts, float) - starts[0]) / 3600
        # Ctrl-C leaves only the times until then.
        known = slice(len(drifters.x))
        return cls(water, hours[known], names, drifters, by_chain[known], place, **about)

    @derived("", "drifters that were simulated", kind="count")
    def released(self) -> int:
        return self.drifters.shore.size

    @derived("", "largest half width of a 95 % interval of a probability", kind="share")
    def precision(self) -> float:
        return float(np.ptp(clopper_pearson(np.array([self.released // 2]), self.released)) / 2)

    @_at("date (UTC)", kind="text")
    def date(self) -> np.ndarray | None:
        if self.on is None or self.starts.size > 1:
            return None
        after = np.round(self.hours * 3600 * (1 if self.tried is None else -1))
        after = after.astype("timedelta64[s]")
        return np.datetime_as_string(self.on.astype("datetime64[s]") + after, unit="m")

    centre_lon = _at("mean longitude of drifters on the map", "degrees_east")(
        lambda found: found._centres[0]
    )
    centre_lat = _at("mean latitude", "degrees_north")(lambda found: found._centres[1])
    spread = _at("spread: root mean square distance from the mean", "km")(
        lambda found: np.array([np.sqrt(np.mean(away**2)) for away in found._distances])
    )
    radius = _at("radius around the mean with nine tenths of the drifters", "km")(
        lambda found: np.array([np.quantile(away, 0.9) for away in found._distances])
    )
    likely_cells = _at("fewest cells with nine tenths of the drifters on the map", kind="count")(
        lambda found: np.array([likely(share, 0.9).sum() for share in found._shares])
    )
    ashore = _at("stranded", "1", kind="share")(lambda found: found.drifters.stranded.mean(axis=1))
    left = _at("off the map", "1", kind="share")(
        lambda found: (found.drifters.cell < 0).mean(axis=1)
    )

    @_at("spread by the chain of cells", "km")
    def chain_spread(self) -> Float[np.ndarray, "times"]:
        here = on_sphere(*(on[self.water.row, self.water.column] for on in (self.lon, self.lat)))
        spreads = []
        for share in self.by_chain:
            away = _kilometres(here, *self.water.centre(share))
            spreads.append(np.sqrt((away**2) @ share / share.sum()) if share.any() else np.nan)
        return np.array(spreads)

    @_at("drifters that the chain has in a wrong cell", "1", kind="share")
    def chain_distance(self) -> Float[np.ndarray, "times"]:
        pairs = zip(self.by_chain, self._shares, strict=True)
        return np.array([total_variation(*pair) for pair in pairs])

    @_at("the same by chance, because drifters are finite", "1", kind="share")
    def chain_noise(self) -> Float[np.ndarray, "times"]:
        halves = [_shares(self.drifters.cell[:, k::2], self.water.cells) for k in (0, 1)]
        return np.array([total_variation(*pair) / 2 for pair in zip(*halves, strict=True)])

    share = _on_map("probability that a drifter is in the cell")(
        lambda found: found._on_map(found._shares)
    )
    low = _on_map("1 in 40 below")(lambda found: found._on_map(found._limits[0]))
    high = _on_map("1 in 40 above")(lambda found: found._on_map(found._limits[1]))
    chain_share = _on_map("probability by the chain of cells")(
        lambda found: found._on_map(found.by_chain)
    )
    arrival = _of_region("probability of an arrival", "1", kind="share")(
        lambda found: found._arrived / found.released
    )
    arrival_low = _of_region("1 in 40 below", "1", kind="share")(
        lambda found: clopper_pearson(found._arrived, found.released)[0]
    )
    arrival_high = _of_region("1 in 40 above", "1", kind="share")(
        lambda found: clopper_pearson(found._arrived, found.released)[1]
    )
    arrival_begin = _of_region("of this, released or found there", "1", kind="share")(
        lambda found: (found.drifters.reached == 0).mean(axis=1)
    )
    arrival_first = _of_region("time until a tenth of those that come later are there", "h")(
        lambda found: found._arrival_hours[:, 0]
    )
    arrival_median = _of_region("time until half of them are there", "h")(
        lambda found: found._arrival_hours[:, 1]
    )
    arrival_last = _of_region("time until nine tenths of them are there", "h")(
        lambda found: found._arrival_hours[:, 2]
    )

    @derived("start", "date (UTC)", kind="text")
    def start_date(self) -> np.ndarray | None:
        if self.on is None or self.starts.size == 1:
            return None
        after = np.round(self.starts * 3600).astype("timedelta64[s]")
        return np.datetime_as_string(self.on.astype("datetime64[s]") + after, unit="m")

    @derived("start region", "probability of an arrival, by release", "1", kind="share")
    def start_arrival(self) -> Float[np.ndarray, "starts regions"] | None:
        if self.starts.size == 1:
            return None
        arrived = np.isfinite(self.drifters.reached)
        return np.stack([part.mean(axis=1) for part in np.split(arrived, self.starts.size, axis=1)])

    stretch_lon = _of_stretch("mean longitude of a stretch of coast", "degrees_east")(
        lambda found: found._stretches[0]
    )
    stretch_lat = _of_stretch("mean latitude", "degrees_north")(lambda found: found._stretches[1])

    @_of_stretch("drifters that come ashore there, or first to a coast if none strands", "1",
                 kind="share")  # fmt: skip
    def stretch_share(self) -> Float[np.ndarray, "stretches"]:
        return self._stretches[2] / self.released

    stretch_low = _of_stretch("1 in 40 below", "1", kind="share")(
        lambda found: clopper_pearson(found._stretches[2].astype(int), found.released)[0]
    )
    stretch_high = _of_stretch("1 in 40 above", "1", kind="share")(
        lambda found: clopper_pearson(found._stretches[2].astype(int), found.released)[1]
    )

    @property
    def attributes(self) -> Mapping[str, Any]:
        return {"Conventions": "CF-1.8", "source": f"jaxcell; currents of {self.source}"}

    @property
    def answer(self) -> tuple[str, ...]:
        """The place, the coast, the regions, and the certainty, each in a sentence."""
        return tuple(filter(None, (self._where, *self._arrivals, self._certain)))

    @property
    def _where(self) -> str:
        on = "" if self.on is None else f" on {name_day(self.on)}"
        then = "" if self.date is None else f" ({self.date[-1].replace('T', ' ')})"
        time, more = in_time(self.hours[-1]), self.starts.size - 1
        if self.tried is not None:
            begin = f"Found{on} {self.around}: {time} before{then} the mean place was"
        else:
            also = f" and {counted(more, 'time')} more, the last {in_time(self.starts[-1])} later,"
            also = also if more else ""
            begin = f"Released{on}{also} {self.around}: after {time}{then} the mean is"
        gone = f"{percent(self.left[-1])} have left the map"
        if self.drifters.stranded.any():
            gone = f"{percent(self.ashore[-1])} are stranded, {gone}"
        if np.isnan(self.centre_lon[-1]):
            return f"{begin} nowhere: no drifter is on the map."
        place = name_place(self.centre_lon[-1], self.centre_lat[-1])
        end = f"; {gone}." if self.tried is None else "."
        return (
            f"{begin} {place}, the spread {name_length(self.spread[-1])}; 90 % are within "
            f"{name_length(self.radius[-1])} of it, and in "
            f"{counted(int(self.likely_cells[-1]), 'cell')}{end}"
        )

    @property
    def _arrivals(self) -> list[str]:
        lines, side = [], np.sqrt(self.water.sides.prod(axis=0)).mean() / 1000
        are, begin, come = "are", "release", "come later a tenth within"
        if self.tried is not None:
            are, begin, come = "were", "find", "were there earlier a tenth within"
        for row, name in enumerate(self.names.tolist()):
            limits = f"{percent(self.arrival_low[row])} to {percent(self.arrival_high[row])}"
            text = f"{percent(self.arrival[row])} ({limits}) {are} at some time in {name}"
            if row == len(self.names) - 1:
                text += f" ({name_length(side)})"
            if self.arrival_begin[row]:
                text += f", {percent(self.arrival_begin[row])} at the {begin}"
            if not np.isnan(self._arrival_hours[row, 0]):
                first, half, last = map(in_time, self._arrival_hours[row].tolist())
                text += f"; of those that {come} {first}, half {half}, nine tenths {last}"
            if self.start_arrival is not None and self.arrival[row]:
                by_start = self.start_arrival[:, row]
                text += f"; by release from {percent(by_start.min())} to {percent(by_start.max())}"
            lines.append(text)
        if self.stretch_share.size:
            place = name_place(self.stretch_lon[0], self.stretch_lat[0])
            most = "most strand" if self.drifters.stranded.any() else "most"
            lines[-1] += f"; {most}, {percent(self.stretch_share[0])}, around {place}"
        return [f"{line}." for line in lines]

    @property
    def _certain(self) -> str:
        apart, use = self.chain_distance[-1], "may not be used for this release"
        if apart <= _CLOSE + self.chain_noise[-1]:
            use = "may be used"
        of, given = f"{self.released:,} drifters give", "in this current without its errors"
        if self.tried is not None:
            of = f"{self.released:,} drifters that were found, of {self.tried:,}, give"
            given = f"if it may come from anywhere in the water of the map alike, {given}"
        return (
            f"How sure: {of} each probability to {percent(self.precision)}, {given}. The chain of "
            f"cells has {percent(apart)} in a wrong cell (by chance "
            f"{percent(self.chain_noise[-1])}) and a spread of "
            f"{name_length(self.chain_spread[-1])}: it {use}."
        )

    def _on_map(self, shares: Float[np.ndarray, "times cells"]) -> np.ndarray:
        return np.stack([self.water.on_grid(share) for share in shares])

    @functools.cached_property
    def _shares(self) -> Float[np.ndarray, "times cells"]:
        return _shares(self.drifters.cell, self.water.cells)

    @functools.cached_property
    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        return clopper_pearson(np.rint(self._shares * self.released).astype(int), self.released)

    @functools.cached_property
    def _centres(self) -> tuple[np.ndarray, np.ndarray]:
        lon, lat = np.full((2, self.hours.size), np.nan)
        for time, place in enumerate(self._points):
            if place.size:
                x, y, z = place.mean(axis=1)
                lon[time], lat[time] = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
        return lon, lat

    @property
    def _points(self) -> list[Float[np.ndarray, "3 some"]]:
        """The unit vectors of the drifters on the map at each time."""
        sets = zip(self.drifters.x, self.drifters.y, self.drifters.cell >= 0, strict=True)
        return [on_sphere(*in_degrees(self.water, x[on], y[on])) for x, y, on in sets]

    @functools.cached_property
    def _distances(self) -> list[Float[np.ndarray, "some"]]:
        """The distances in km of drifters on the map from their mean, at each time."""
        sets = zip(self._points, *self._centres, strict=True)
        return [
            _kilometres(points, lon, lat) if points.size else np.array([np.nan])
            for points, lon, lat in sets
        ]

    @property
    def _arrived(self) -> Int[np.ndarray, "regions"]:
        return np.isfinite(self.drifters.reached).sum(axis=1)

    @functools.cached_property
    def _arrival_hours(self) -> Float[np.ndarray, "regions 3"]:
        """The quantiles of the times of those that come after the release; NaN without one."""
        hours = [row[np.isfinite(row) & (row > 0)] / 3600 for row in self.drifters.reached]
        nothing = np.full(len(_QUANTILES), np.nan)
        return np.stack([np.quantile(h, _QUANTILES) if h.size else nothing for h in hours])

    @functools.cached_property
    def _stretches(self) -> Float[np.ndarray, "3 stretches"]:
        """The mean position and the drifters of each stretch, the most visited stretch first."""
        water, shore = self.water, self.drifters.shore[self.drifters.shore >= 0]
        block = water.row // _BLOCK * water.number.shape[1] + water.column // _BLOCK
        names, count = np.unique(block[shore], return_counts=True)
        weight = np.bincount(shore, minlength=water.cells)
        rows = [
            (*water.centre(np.where(block == name, weight, 0.0)), float(seen))
            for name, seen in zip(names.tolist(), count.tolist(), strict=True)
        ]
        return np.array(sorted(rows, key=lambda row: -row[2])).reshape(-1, 3).T


def _joined(parts: Sequence[Release]) -> Release:
    """Join the drifters of several releases."""
    names = [field.name for field in dataclasses.fields(Release)]
    return Release(*(np.concatenate([getattr(p, name) for p in parts], axis=-1) for name in names))


def _shares(
    cell: Int[np.ndarray, "times drifters"], cells: int
) -> Float[np.ndarray, "times cells"]:
    return np.stack([np.bincount(row[row >= 0], minlength=cells) for row in cell]) / cell.shape[1]


def _kilometres(
    points: Float[np.ndarray, "3 some"], lon: float, lat: float
) -> Float[np.ndarray, "some"]:
    """Compute great-circle distances from a place."""
    return distances(points, on_sphere(*np.array([lon, lat])[:, None])) / 1000
