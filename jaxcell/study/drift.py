import dataclasses
import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import tyro

from .sea_study import Count, SeaStudy
from .study import Length, Limit, Metres, Say, Seconds, about, numbers, refuse, require, silent


if TYPE_CHECKING:
    import xarray as xr

    from ..drift import DriftStep, SeaDrift, Water


_DEEP = '"lon,lat,depth" in degrees and metres'
_PLACES = {"start": (2, '"lon,lat" in degrees'), "goal": (3, _DEEP)}
_Duration: TypeAlias = Annotated[Seconds, Limit("more than 0 seconds", lambda x: x > 0)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drift(SeaStudy):
    """Find where an ocean current carries drifters, where to drop them, and their way to a goal."""

    name: ClassVar[str] = "drift"

    file: tyro.conf.Positional[tuple[Path, ...]]
    """Currents: NetCDF files whose records or velocities go together, a pattern such as
    "2016_*.nc", a Zarr store, an address of OPeNDAP, or @gyres."""
    grid: Path | None = None
    """File of the grid, where it is not in those of the currents, as mesh_mask.nc of NEMO."""
    time: int | str | None = None
    """One record, by its number from 0 or its moment (2016-02-02T12:00); by default all records."""
    current: Literal["changing", "mean"] | None = None
    """What drifters go with: the records one after the other, again and again (changing), or their
    mean. By default it changes, but for --method source."""
    depths: tuple[Metres, ...] = ()
    """Depths of the layers in metres; by default those of the file, or the surface."""
    bounds: tuple[float, float, float, float] | None = None
    """West, south, east and north of the part to read, in degrees."""
    variables: tuple[str, str] | None = None
    """Names of the velocities towards the East and North, where the file leaves it open."""
    windage: Annotated[float, Limit("a share from 0 to 1", lambda x: 0 <= x <= 1)] = 0.0
    """Share of the speed of the wind that drifters at the surface have too, of a file with wind."""
    stokes: bool = False
    """Whether they have the Stokes drift of waves too, of a file that has it."""
    duration: _Duration | None = None
    """Seconds that a step takes; by default what brings the map nearest to drifters, or for the
    source the time in which they drift by one cell on average in the slowest layer."""
    method: Literal["drifters", "source"] = "drifters"
    """How cells are mapped: as points in them drift, which may leave the map (drifters); or by the
    rules of the dissertation, with turned disturbances and a closed edge (source)."""
    rho: Annotated[float, Limit("a probability from 0 to 1", lambda x: 0 <= x <= 1)] = 0.8
    """Probability that a step goes where the current says, for --spread turned or all."""
    spread: Literal["turned", "all", "sampled"] | None = None
    """Where a step may go instead: along the current turned by 45 degrees to either side; to all
    cells around its end; or, for a known current, wherever points of the cell go. By default that
    of --method."""
    edge: Literal["uniform", "exit"] | None = None
    """Whether drifters at a coast or the edge of the map go on to any cell beside them, as in the
    dissertation, or drift like others and may leave the map. By default that of --method."""
    diffusivity: Annotated[float, Limit("0 m2/s or more", lambda x: x >= 0)] = 0.0
    """Horizontal diffusivity in m2/s, of what the current does not resolve."""
    backward: bool = False
    """Whether drifters go back in time, from the last record on: where do they come from?"""
    start: str | None = None
    """Where a drifter is dropped, "lon,lat" in degrees."""
    goal: str | None = None
    """Where it is to be, "lon,lat,depth" in degrees and metres; it may go up and down."""
    regions: Path | None = None
    """GeoJSON file of polygons: how do drifters at the surface go from one to another?"""
    after: _Duration = 432_000.0
    """Seconds after which it is asked in which of the regions they are, and how many on beaches."""
    beaching: _Duration | None = None
    """Seconds in which half of the drifters in a cell at a coast strand, at the surface."""
    resuspension: _Duration | None = None
    """Seconds in which half of those on a beach are afloat again; by default they stay there."""
    range: Length | None = None
    """How far a drifter that looks at the sea bed sees, in metres."""
    search: _Duration | None = None
    """Seconds to look for the fewest of these views; by default they are chosen greedily."""
    nearly_closed: Count | None = None
    """How many parts of the water to find in each layer that drifters hardly leave in a day; they
    change less with the duration of a step than persistent groups."""
    discount: Annotated[float, Limit("more than 0 and less than 1", lambda x: 0 < x < 1)] = 0.99
    """What a step later is worth, for the way to the goal."""
    seed: int = 0
    """Seed of the drifters that are recorded."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._place("start")
        self._place("goal")
        # Which is the spread of the method "drifters".
        if (self.spread or self.method) in ("sampled", "drifters"):
            refuse(self, "for a spread that is sampled", "rho")
        if self.beaching is None:
            refuse(self, "without beaching", "resuspension")
            if self.regions is None:
                refuse(self, "without regions or beaching", "after")
        if self.range is None:
            refuse(self, "without a range", "search")
        if self.goal is None:
            refuse(self, "without a goal", "discount")

    def currents(self) -> "xr.Dataset":
        """Read the currents."""
        pushes = self.windage, self.stokes
        chosen = self.time, self.depths, self.bounds, self.variables
        return _currents(self.file, self.grid, *chosen, *pushes)

    def memory(self, written: bool = False) -> float | int:
        from ..base import memory
        from ..space import estimates

        cells = [int(layer.sum()) for layer in self.currents().water.values]
        needed = estimates.drift(cells)
        doing = f"drift in {sum(cells):,} cells of water"
        memory.check(needed, doing, "choose smaller bounds, or fewer depths")
        return needed

    def run(self, say: Say = silent) -> "SeaDrift":
        from ..drift import ClosedSets, Exchange, SeaDrift, Stranded, Water, read_regions
        from ..drift.deployment import check_reach

        self.memory()
        currents = self.currents()
        waters = [Water.of(currents, layer) for layer in range(currents.sizes["layer"])]
        fewest = min(water.cells for water in waters)
        expected = f"at most {fewest}, the cells of a layer"
        require("nearly_closed", self.nearly_closed, expected, lambda n: n <= fewest)
        if self.range is not None:
            check_reach(waters[0], self.range, "range")
        start, goal = self._start(waters[0]), self._goal(waters)
        regions = None if self.regions is None else read_regions(self.regions, waters[0])
        found = SeaDrift.of(
            currents,
            self._step,
            start=start,
            reach=self.range,
            seconds=self.search,
            mean=self._mean,
            backward=self.backward,
            diffusivity=self.diffusivity,
            say=say,
        )
        surface = found.layers[0].behaviour
        more: dict[str, Any] = {}
        if regions is not None:
            say("following drifters between regions")
            more["exchange"] = Exchange.of(surface, *regions, self.after)
        if self.beaching is not None:
            say("stranding drifters")
            halves = {"afloat": self.beaching, "stranded": self.resuspension or math.inf}
            more["beaching"] = Stranded.of(waters[0], surface, self.after, **halves)
            if found.step > self.beaching:
                rough = (
                    f"A step takes {found.step:g} s, and those that pass a coast meanwhile do not "
                    f"strand; give a --duration below the {self.beaching:g} s of beaching."
                )
                more["notices"] = (*found.notices, rough)
        if (count := self.nearly_closed) is not None:
            say("finding nearly closed sets")
            chains = [layer.behaviour.chain for layer in found.layers]
            more["nearly_closed_sets"] = ClosedSets.of(found.waters, chains, found.step, count)
        found = dataclasses.replace(found, **more)
        if goal is not None:
            say(f"finding the way to the goal from {found.cells:,} cells")
            found = found.towards(goal, self.discount)
        if self.range is not None:
            say("choosing where to see the sea bed")
            # Kept by the result, so last.
            _ = found.views
        return found

    def spec(self, result: Any) -> dict[str, Any]:
        rules = {"spread": self._step.spread, "edge": self._step.edge}
        rules["current"] = "mean" if self._mean else "changing"
        of_result = {"depths_m": result.depths, "duration_s": result.step}
        return {**super().spec(result), **rules, **of_result}

    def write(self, result: "SeaDrift", out: Path) -> None:
        from .. import record

        record.save_deployment(result, out / "deployment.csv")
        record.save_deployment(result, out / "deployment.geojson")

    @property
    def _step(self) -> "DriftStep":
        """The step by the method, with the choices that differ from it."""
        from ..drift import METHODS

        chosen: dict[str, Any] = {"spread": self.spread, "edge": self.edge}
        chosen = {name: value for name, value in chosen.items() if value is not None}
        step = METHODS[self.method]
        return dataclasses.replace(step, duration=self.duration, rho=self.rho, **chosen)

    @property
    def _mean(self) -> bool:
        """Whether maps are by the mean of the records."""
        return (self.current or ("mean" if self.method == "source" else "changing")) == "mean"

    def _place(self, end: Literal["start", "goal"]) -> list[float] | None:
        text = getattr(self, end)
        return None if text is None else numbers(end, text, *_PLACES[end])

    def _start(self, water: "Water") -> int | None:
        if (place := self._place("start")) is None:
            return None
        with about(f"start {self.start}"):
            return int(water.cell(*place))

    def _goal(self, waters: "list[Water]") -> int | None:
        """The number of the goal among the cells of all layers."""
        if (place := self._place("goal")) is None:
            return None
        lon, lat, depth = place
        depths = [water.depth for water in waters]
        near = [layer for layer, one in enumerate(depths) if abs(one - depth) < 0.005]
        if not near:
            listed = ", ".join(f"{one:g}" for one in depths)
            raise ValueError(
                f"goal {self.goal}: expected one of the depths {listed} m, got {depth:g}"
            )
        with about(f"goal {self.goal}"):
            cell = int(waters[near[0]].cell(lon, lat))
        return cell + sum(water.cells for water in waters[: near[0]])


# The currents are read once for the members of a sweep.
@functools.lru_cache(maxsize=8)
def _currents(
    file: tuple[Path, ...],
    grid: Path | None,
    time: int | str | None,
    depths: tuple[float, ...],
    bounds: tuple[float, float, float, float] | None,
    variables: tuple[str, str] | None,
    windage: float,
    stokes: bool,
) -> "xr.Dataset":
    from ..drift import open_currents
    from ..drift.currents.netcdf import TooLargeError

    read = functools.partial(
        open_currents,
        file,
        grid=grid,
        time=time,
        depths=depths or None,
        bounds=bounds,
        variables=variables,
        windage=windage,
        stokes=stokes,
    )
    try:
        return read()
    except (TooLargeError, MemoryError):
        if time is not None:
            raise
        return read(mean=True)
