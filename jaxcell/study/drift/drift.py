import contextlib
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from ... import drift, record, space, verify as verification
from ...base import memory
from ...base.process import stoppable
from ..parameters import (
    AtLeastOne,
    Days,
    Duration,
    Headings,
    Length,
    Limit,
    Metres,
    Only,
    Share,
)
from ..study import Say, about, numbers, silent
from .sea_study import CurrentStudy, Source


if TYPE_CHECKING:
    import xarray as xr


_DEEP = '"lon,lat,depth" in degrees and metres'
# The default number of nearly closed sets.
_USUAL_SETS = 3
_PLACES = {
    "start": (("deg", "deg"), '"lon,lat" in degrees'),
    "goal": (("deg", "deg", "m"), _DEEP),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drift(CurrentStudy):
    """Find where a current carries drifters, where to drop them, and how they reach a goal."""

    name: ClassVar[str] = "drift"
    command: ClassVar[str] = "drift"
    example: ClassVar[str] = "@gyres --depths 0 --out runs/drift"
    task: ClassVar[str] = "drift"
    headings: ClassVar[Headings] = {
        "Which current carries them?": (
            *("grid", "time", "current", "variables"),
            *("windage", "stokes", "land", "gaps"),
        ),
        "How do they move in a step?": (
            *("duration", "method", "rho", "spread"),
            *("edge", "coast", "diffusivity"),
        ),
        "For how long, and how exactly?": (
            *("until", "drifters", "after", "resuspension"),
            *("search", "discount", "seed"),
        ),
    }

    file: tyro.conf.Positional[Source] = dataclasses.field(kw_only=False)
    """Currents: NetCDF files (one per period, or one for u and one for v), a pattern such as
    "2016_*.nc", a Zarr store, an OPeNDAP address, or the bundled @gyres."""
    time: int | str | None = None
    """Records to read: a month (2016-02), a period (2016-02-01/2016-02-11), or one record by its
    number, from 0, or its time (2016-02-02T12:00). By default all records are read."""
    current: Literal["changing", "mean", "steady"] | None = None
    """Current of the map: the records in turn, repeated without end (changing), or the mean of the
    records, while simulated drifters move with the records in turn (mean) or with the mean, too
    (steady, which needs the least memory). By default changing, but mean with --method source."""
    depths: tuple[Metres, ...] = ()
    """Depths of layers in metres; by default those in the file or, if it has none, the surface."""
    duration: Duration | None = None
    """Duration of a step in seconds. By default the duration at which the map agrees best with
    simulated drifters; with --method source the time in which drifters of the slowest layer move by
    one cell on average."""
    method: Literal["drifters", "source"] = "drifters"
    """Method to build the map of cells: follow sample points of each cell, which may leave the map
    (drifters), or use the rules of Alam 2018 (source): --spread turned and --edge uniform."""
    rho: Annotated[Share, Only(spread=("turned", "all")), Only(method="source")] = 0.8
    """Probability that a drifter follows the current in a step, without a disturbance."""
    spread: Literal["turned", "all", "sampled"] | None = None
    """Cells to which a step leads: the cell ahead along the current, and those at 45 degrees to
    either side (turned); the cell ahead and all cells around it (all); or the cells that sample
    points reach (sampled). By default turned with --method source, and otherwise sampled."""
    edge: Literal["uniform", "exit"] | None = None
    """Rule for drifters at a coast or at the edge of the map: they stay or move to a random
    neighbouring cell, as in Alam 2018 (uniform), or drift as elsewhere and may leave the map
    (exit). By default uniform with --method source, and otherwise exit."""
    until: Annotated[Days | None, Limit(gt=0)] = None
    """Time in days after which the map is compared with simulated drifters; by default the median
    time until drifters reach a persistent group or leave the map, in whole days from 1 to 30."""
    backward: bool = False
    """Follow drifters backward in time from the last record, to find their origins."""
    start: str | None = None
    """Position at which a drifter is dropped, "lon,lat" in degrees."""
    goal: str | None = None
    """Goal of a drifter that may change its depth, "lon,lat,depth" in degrees and metres."""
    regions: Path | None = None
    """GeoJSON file of polygons, to compute the exchange of surface drifters between them. The cells
    of a polygon are those whose centre is in it."""
    drifters: Annotated[AtLeastOne, Only(regions=True)] = 10_000
    """Number of drifters to simulate from each region, for confidence intervals."""
    after: Annotated[Duration, Only(regions=True), Only(beaching=True)] = 432_000.0
    """Time in seconds after which drifters are counted in the regions and on beaches."""
    beaching: Annotated[Duration | None, Only(coast=("hold", "slip"))] = None
    """Time in seconds after which half of the surface drifters in coastal cells have stranded."""
    resuspension: Annotated[Duration | None, Only(beaching=True)] = None
    """Time in seconds in which half of the drifters on a beach float again; by default they never
    float again."""
    range: Length | None = None
    """Range in metres of cameras on drifters, which together have to see the whole sea bed."""
    search: Annotated[Duration | None, Only(range=True)] = None
    """Time limit in seconds of a search for the fewest camera positions; by default there is no
    search, and the positions are chosen greedily."""
    nearly_closed: AtLeastOne | None = None
    """Number of nearly closed sets to find in each layer: parts of the water that drifters hardly
    leave up to the time of --until. They depend less on the duration of a step than persistent
    groups do. By default 3, and none if the search may take more than a minute."""
    discount: Annotated[float, Limit(gt=0, lt=1), Only(goal=True)] = 0.99
    """Discount factor per step of rewards: 100 for a step that reaches the goal, otherwise -1."""
    seed: int = 0
    """Seed of the simulated drifters."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method == "source" and self.spread == "sampled":
            raise ValueError("spread: expected turned or all with `method` source, got sampled")
        self._place("start")
        self._place("goal")

    def currents(self) -> "xr.Dataset":
        """Read the currents from the files, with the options that the parameters give."""
        steady = self.current == "steady"
        return self.read(time=self.time, depths=self.depths or None, mean=steady)

    def memory(self, written: bool = False) -> float | int:
        cells = [int(layer.sum()) for layer in self.currents().water.values]
        needed = space.estimates.drift(cells)
        doing = f"drift in {sum(cells):,} cells of water"
        memory.check(needed, doing, "choose smaller bounds, or fewer depths")
        return needed

    def run(self, say: Say = silent) -> "drift.SeaDrift":
        from ...drift.deployment import check_reach
        from ...drift.results.sea_drift import LONGEST

        self.memory()
        currents = self.currents()
        layers = range(currents.sizes["layer"])
        waters = [drift.Water.of(currents, layer, self.coast) for layer in layers]
        fewest = min(water.cells for water in waters)
        Limit(le=fewest).check("nearly_closed", self.nearly_closed, ", the cells of a layer")
        if self.range is not None:
            check_reach(waters[0], self.range, "range")
        start, goal = self._start(waters[0]), self._goal(waters)
        regions = None if self.regions is None else drift.read_regions(self.regions, waters[0])
        result = drift.SeaDrift.of(
            currents,
            self._step,
            start=start,
            reach=self.range,
            seconds=self.search,
            mean=None if self.current is None and not self._mean else self._mean,
            backward=self.backward,
            diffusivity=self.diffusivity,
            until=None if self.until is None else 24 * self.until,
            coast=self.coast,
            say=say,
        )
        with stoppable():
            surface = result.layers[0].behaviour
            more: dict[str, Any] = {}
            if regions is not None:
                say("following drifters between regions")
                exchange = drift.Exchange.of(surface, *regions, self.after)
                going = waters[0], result.layers[0].flow, self.drifters, self.seed
                more["exchange"] = exchange.with_drifters(*going)
            if self.beaching is not None:
                say("stranding drifters")
                halves = {"afloat": self.beaching, "stranded": self.resuspension or math.inf}
                more["beaching"] = drift.Stranded.of(waters[0], surface, self.after, **halves)
                if result.step > self.beaching:
                    rough = (
                        f"A step takes {result.step:g} s, and drifters that pass a coast during a "
                        f"step do not strand; give a --duration below the {self.beaching:g} s of "
                        "--beaching."
                    )
                    more["notices"] = (*result.notices, rough)
            result = dataclasses.replace(result, **more)
            say("comparing the map with simulated drifters")
            hours, count = result.asked_hours, self.nearly_closed
            takes = sum(
                drift.closed_sets_seconds(layer.behaviour.chain, result.step, hours=hours)
                for layer in result.layers
            )
            if count is not None or takes <= LONGEST:
                say("finding nearly closed sets")
                # If the solve stalls, sets are left out unless they were requested.
                with contextlib.suppress(*([] if count else [RuntimeError])):
                    wanted = count or min(_USUAL_SETS, fewest)
                    result = result.with_closed_sets(wanted, listed=count is not None)
            else:
                left_out = (
                    f"Nearly closed sets are left out: they may take {takes / 60:.0f} minutes; "
                    f"--nearly-closed {_USUAL_SETS} finds them."
                )
                result = dataclasses.replace(result, notices=(*result.notices, left_out))
            if goal is not None:
                say(f"finding the way to the goal from {result.cells:,} cells")
                result = result.towards(goal, self.discount)
            if self.range is not None:
                say("choosing where to see the sea bed")
                # The result caches its views, so this comes after the last `replace`.
                _ = result.views
        return result

    def spec(self, result: Any) -> dict[str, Any]:
        rules = {"spread": self._step.spread, "edge": self._step.edge, "coast": self.coast}
        rules["current"] = self.current or ("mean" if self._mean else "changing")
        of_result = {"depths_m": result.depths, "duration_s": result.step}
        return {**super().spec(result), **rules, **of_result}

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_drift(result)

    def write(self, result: "drift.SeaDrift", out: Path) -> None:
        record.save_deployment(result, out / "deployment.csv")
        record.save_deployment(result, out / "deployment.geojson")

    @property
    def _step(self) -> "drift.DriftStep":
        """The `DriftStep` of the map, with the duration and the rules from the parameters."""
        chosen: dict[str, Any] = {"spread": self.spread, "edge": self.edge}
        chosen = {name: value for name, value in chosen.items() if value is not None}
        step = drift.METHODS[self.method]
        return dataclasses.replace(step, duration=self.duration, rho=self.rho, **chosen)

    @property
    def _mean(self) -> bool:
        return self.current != "changing" and bool(self.current or self.method == "source")

    def _place(self, end: Literal["start", "goal"]) -> list[float] | None:
        text = getattr(self, end)
        return None if text is None else numbers(end, text, *_PLACES[end])

    def _start(self, water: "drift.Water") -> int | None:
        if (place := self._place("start")) is None:
            return None
        with about(f"start {self.start}"):
            return int(water.cell(*place))

    def _goal(self, waters: "list[drift.Water]") -> int | None:
        """Return the index of the goal among the cells of all layers, or `None` without a goal."""
        if (place := self._place("goal")) is None:
            return None
        lon, lat, depth = place
        depths = [water.depth for water in waters]
        near = [layer for layer, known in enumerate(depths) if abs(known - depth) < 0.005]
        if not near:
            listed = ", ".join(f"{known:g}" for known in depths)
            raise ValueError(
                f"goal {self.goal}: expected one of the depths {listed} m, got {depth:g}"
            )
        with about(f"goal {self.goal}"):
            cell = int(waters[near[0]].cell(lon, lat))
        return cell + sum(water.cells for water in waters[: near[0]])
