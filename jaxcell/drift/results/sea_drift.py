import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import xarray as xr
from jaxtyping import Bool, Int

from ...base.quantities import derived, from_part
from ...currents.ocean import open_currents
from ...mapping import Chain
from ..beaches import Stranded
from ..closed_sets import ClosedSets
from ..deployment import (
    CoverageCurve,
    Deployment,
    VisibleDeployment,
    coverage_curve,
    coverage_seconds,
    deployment_cells,
    minimum_deployment,
    visible_deployment,
)
from ..drift_step import DriftStep
from ..flow import Flow, crossing_time
from ..reachability import ReachedCells, reachable_at_depth, reachable_by_layer
from ..regions import Exchange
from ..validation.markov_test import MarkovTest
from ..voyage_policies import SeaVoyage, Voyage, discounted_voyage, surest_voyage
from ..water import Water
from .current_layer import DistancesOfLayers, DistanceTotals, Layer
from .current_summary import CurrentSummary
from .flattened import flattened
from .layer_maps import check_size, choose_step, map_layers, notices_on
from .layered_result import LayeredResult
from .sentences import answer, remarks_on
from .step_sensitivity import StepSensitivity


# The longest time in seconds in which parts of a result are computed without a request.
LONGEST = 60.0
_index = functools.partial(from_part, kind="index")
_count = functools.partial(from_part, kind="count")


def positions(cells: str, dim: str) -> tuple[Any, Any]:
    """Build two properties: the longitude and the latitude of each cell in the property `cells`."""

    def along(axis: int) -> Callable[[Any], Any]:
        def value(drift: Any) -> Any:
            numbers = getattr(drift, cells)
            return None if numbers is None else drift._lon_lat(numbers)[axis]

        return value

    lon = derived(dim, "longitude", "degrees_east", standard_name="longitude")
    lat = derived(dim, "latitude", "degrees_north", standard_name="latitude")
    return lon(along(0)), lat(along(1))


@dataclasses.dataclass(frozen=True, eq=False)
class SeaDrift(LayeredResult):
    """The long-term behaviour of drifters in layers of the sea, with deployments and voyages.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> sea = drift.SeaDrift.of(currents)
        >>> sea.cells, sea.depths, round(sea.step / 60), sea.persistent_groups
        (538, [0.0], 31, 3)
    """

    title: ClassVar[str] = "Long-term behaviour of drifters in an ocean current"
    tables: ClassVar[Mapping[str, str]] = {
        "other_step": "sensitivity",
        "drifter": "deployment",
        "fewest": "minimum",
        "view": "views",
    }

    brief: ClassVar[tuple[str, ...]] = (
        *("asked_hours", "distance", "release_distance", "compared_cells"),
        *("coast", "cells", "step", "period_hours", "diffusivity", "views_least", "view"),
        *("persistent_groups", "mean_leaving", "mean_leaving_into_gaps", "mean_leaving_off_edge"),
        *("mean_stranding", "median_hours", "reached_cells", "reached_cells_at_any_depth"),
    )
    largest: ClassVar[int] = 2_500_000
    "The number of cells times phases above which solves would take minutes."

    layers: tuple[Layer, ...]
    currents: xr.Dataset
    "The currents, a dataset of [`jaxcell.drift.open_currents`][]."
    start: int | None = None
    "The cell of the surface where a drifter is dropped; `None` if there is no start."
    reach: float | None = None
    "The radius of the disc of the sea bed that a camera sees, in metres."
    seconds: float | int | None = None
    "Time limit of [`jaxcell.drift.visible_deployment`][], in seconds; `None` for a greedy cover."
    voyage: SeaVoyage | None = None
    "The voyage to a goal with the discounted policy."
    surest: SeaVoyage | None = None
    "The voyage with the policy that has the highest probability of arrival."
    exchange: Exchange | None = None
    "The exchange of drifters between regions of the surface."
    beaching: Stranded | None = None
    "The stranding of drifters at the surface."
    nearly_closed_sets: ClosedSets | None = None
    "Sets of cells that few drifters leave."
    sets_listed: bool = True
    "True if a table of the nearly closed sets is printed."
    markov_test: MarkovTest | None = None
    "The Chapman-Kolmogorov test of the maps on the nearly closed sets."
    until: float | int | None = None
    "The time of interest, in hours; `None` for the default of [`jaxcell.drift.asked_hours`][]."
    backward: bool = False
    "True if drifters go backward in time."
    notices: tuple[str, ...] = ()
    "Notes on differences between the request and the computation."

    def __post_init__(self) -> None:
        super().__post_init__()
        layers, surface = self.currents.sizes["layer"], self.waters[0].cells
        if len(self.layers) != layers:
            raise ValueError(f"layers: expected {layers}, got {len(self.layers)}")
        if self.start is not None and not 0 <= self.start < surface:
            raise ValueError(f"start: expected a cell of the surface, 0 to {surface - 1}")
        for name, voyage in (("voyage", self.voyage), ("surest", self.surest)):
            if voyage is not None and voyage.policy.goal.size != self.cells:
                raise ValueError(
                    f"{name}: expected that of {self.cells} cells, got {voyage.policy.goal.size}"
                )

    @classmethod
    def of(
        cls,
        currents: xr.Dataset,
        step: DriftStep | None = None,
        *,
        start: int | None = None,
        reach: float | None = None,
        seconds: float | int | None = None,
        mean: bool | None = None,
        backward: bool = False,
        diffusivity: float | int = 0.0,
        until: float | int | None = None,
        coast: str = "hold",
        say: Callable[..., None] = lambda *_: None,
    ) -> "SeaDrift":
        """Compute the long-term behaviour in each layer.

        A current of several records changes from record to record, and repeats itself after the
        last one. There is a map for each phase of the period, and groups and times are for drifters
        that are released at the first record.

        **Arguments:**

        - `currents`: the currents, from [`jaxcell.drift.open_currents`][], or a dataset that this
            function takes.
        - `step`: the step, such as one of `jaxcell.drift.METHODS`. Its duration must be 0.001 to
            1000 times the [`jaxcell.drift.crossing_time`][] of the slowest layer, and is changed to
            fit the period. By default the duration is chosen by [`jaxcell.drift.nearest_step`][] if
            the spread is `"sampled"`, and otherwise is the crossing time.
        - `start`: the cell of the surface where a drifter is dropped.
        - `reach`: the radius of the disc of the sea bed that a camera sees, in metres.
        - `seconds`: the time limit of [`jaxcell.drift.visible_deployment`][], in seconds.
        - `mean`: whether to make the map from the mean of the records. By default it is made from
            the records in turn, and refused if it takes minutes: if cells times phases exceed 2.5
            million. `False` makes it at any size.
        - `backward`: whether drifters go backward in time from the last record.
        - `diffusivity`: the diffusivity of unresolved motion, in m²/s, for the spread `"sampled"`.
        - `until`: the hours up to which results matter; by default [`jaxcell.drift.asked_hours`][].
        - `coast`: the rule for drifters that run ashore, as for [`jaxcell.drift.Water`][].
        - `say`: a function that is called with the name of each stage of the computation.

        **Raises:** `MemoryError` if the maps of all phases do not fit into the free memory;
        `ValueError` if they take minutes and `mean` is not given.
        """
        step = step or DriftStep()
        if "layer" not in currents.dims:
            currents = open_currents(currents)
        count = range(currents.sizes["layer"])
        waters = [Water.of(currents, k, coast) for k in count]
        flows = [Flow.of(currents, k, diffusivity=diffusivity, coast=coast) for k in count]
        flows = [(flow.reversed() if backward else flow).repeated() for flow in flows]
        by = [flow.mean() for flow in flows] if mean else flows
        step.check_duration(max(map(crossing_time, waters, flows)))
        chosen, made = choose_step(waters, flows, by, step, until, say)
        if not mean:
            phases = by[0].phases(chosen.duration or 0)
            check_size(waters, phases, None if mean is False else cls.largest)
        layers = map_layers(waters, flows, by, chosen, made, start, until, say)
        notices = notices_on(currents, by[0], step, chosen, backward)
        return cls(
            layers, currents, start, reach, seconds,
            until=until, backward=backward, notices=notices,
        )  # fmt: skip

    def towards(self, goal: npt.ArrayLike | int, discount: float = 0.99) -> "SeaDrift":
        """Add two voyages to a goal: one with a `discount` per step, one with the surest policy."""

        def on_sea(policy: Voyage) -> SeaVoyage:
            place = self.place(int(np.flatnonzero(policy.goal)[0]))
            return SeaVoyage(self.sea, policy, self.step / 3600, place, self.start)

        return dataclasses.replace(
            self,
            voyage=on_sea(discounted_voyage(self.sea, goal, discount)),
            surest=on_sea(surest_voyage(self.sea, goal)),
        )

    def with_closed_sets(self, count: int, *, listed: bool = True) -> "SeaDrift":
        """Add nearly closed sets of layers, printed if `listed`, and a test of the maps on them.

        They are nearly closed up to the time of interest, `asked_hours`.
        """
        chains = [layer.behaviour.chain for layer in self.layers]
        sets = ClosedSets.of(self.waters, chains, self.step, count, self.asked_hours)
        tests, first = [], 0
        for layer, found in zip(self.layers, sets.layers, strict=True):
            tests.append(layer.tested(found.begin, first))
            first += found.count
        test = MarkovTest.joined(tests)
        return dataclasses.replace(
            self, nearly_closed_sets=sets, sets_listed=listed, markov_test=test
        )

    @property
    def quiet(self) -> tuple[str, ...]:
        return ("markov_test", *(() if self.sets_listed else ("nearly_closed_sets",)))

    @property
    def answer(self) -> tuple[str, ...]:
        return answer(self)

    @property
    def answered(self) -> bool:
        return self.surest is None or self.surest.arrives

    @property
    def remarks(self) -> tuple[str, ...]:
        return remarks_on(self)

    @property
    def attributes(self) -> Mapping[str, Any]:
        source = self.currents.attrs["source"]
        return {
            "Conventions": "CF-1.8",
            "source": f"jaxcell; definitions of Alam 2018, chapter 5; currents of {source}",
        }

    @flattened()
    def distance_totals(self) -> DistanceTotals:
        return DistanceTotals(self.layers)

    @flattened()
    def current_summary(self) -> CurrentSummary:
        return CurrentSummary(self.currents, self.layers, self.sea)

    @flattened("sensitivity_")
    def step_sensitivity(self) -> StepSensitivity | None:
        return StepSensitivity.of(self.layers[0])

    @flattened()
    def distances_of_layers(self) -> DistancesOfLayers:
        return DistancesOfLayers(self.layers, self.sea)

    @flattened()
    def reached_from_start(self) -> ReachedCells | None:
        return None if self.reachable is None else ReachedCells(self.sea, *self.reachable)

    @functools.cached_property
    def reachable(self) -> tuple[Bool[np.ndarray, "cells"], Bool[np.ndarray, "cells"]] | None:
        """The masks of the cells that can ever be reached from the start; `None` without a start.

        In the first mask they change their layer only at the start; in the second, at any time.
        """
        if self.start is None:
            return None
        return reachable_by_layer(self.sea, self.start), reachable_at_depth(self.sea, self.start)

    @functools.cached_property
    def deployment(self) -> Deployment:
        """The cells of the surface in which to drop drifters, from Alg. 5.2."""
        return deployment_cells(self.layers[0].behaviour)

    @functools.cached_property
    def minimum(self) -> Int[np.ndarray, "fewest"]:
        """A small set of cells from which all cells of the surface can ever be reached.

        In a steady current it is the smallest set, in a periodic current that of a greedy search.
        """
        chain = self.layers[0].behaviour.chain
        if isinstance(chain, Chain):
            return minimum_deployment(chain)
        return np.sort(self.deployment.cells if self.curve is None else self.curve.cells)

    @functools.cached_property
    def curve(self) -> CoverageCurve | None:
        """The numbers of cells that drifters can ever reach; `None` if it takes minutes."""
        chain = self.layers[0].behaviour.chain
        return coverage_curve(chain) if self.curve_seconds <= LONGEST else None

    @functools.cached_property
    def curve_seconds(self) -> float:
        """The seconds that the curve takes, as foretold by [`jaxcell.drift.coverage_seconds`][]."""
        return coverage_seconds(self.layers[0].behaviour.chain)

    @functools.cached_property
    def views(self) -> VisibleDeployment | None:
        """The cells in which to drop drifters with cameras; `None` if there is no `reach`."""
        surface = self.layers[0]
        if self.reach is None:
            return None
        return visible_deployment(
            surface.water, self.reach, surface.begins.groups, seconds=self.seconds
        )

    drifter_count = _count(
        "deployment.cells.size",
        "",
        "drifters of the deployment, from which each cell can ever be reached",
    )
    fewest_count = _count(
        "minimum.size", "", "fewest cells found from which each cell can ever be reached"
    )

    deployment_cell = _index("deployment.cells", "drifter", "cell to drop a drifter in")
    deployment_lon, deployment_lat = positions("deployment_cell", "drifter")
    deployment_group = _index("deployment.group", "drifter", "persistent group, -1 if transient")
    deployment_transient_group = _index(
        "deployment.transient_group", "drifter", "transient group, -1 if persistent"
    )
    deployment_gained = _count(
        "deployment.gained",
        "drifter",
        "cells of its group that can ever be reached, and not from earlier ones",
    )
    minimum_cell = _index("minimum", "fewest", "cell of the smallest deployment")
    minimum_lon, minimum_lat = positions("minimum_cell", "fewest")
    curve_cell = _index("curve.cells", "drifters", "cell to drop the first, second, ... drifter in")
    curve_covered = _count(
        "curve.covered",
        "drifters",
        "cells that this and earlier drifters can ever reach",
        listed=True,
    )
    views_cell = _index("views.cover", "view", "cell from which the sea bed is seen")
    views_lon, views_lat = positions("views_cell", "view")

    @derived("view", "whether a drifter is dropped there", kind="flag")
    def views_kept(self) -> Bool[np.ndarray, "views"] | None:
        return None if self.views is None else np.isin(self.views.cover, self.views.cells)

    views_least = _count("views.least", "", "lower bound of the number of views")
    start_cell = _index("start", "", "cell where the drifter is dropped")

    @derived("goals", "cells of the goal", kind="index")
    def goal(self) -> Int[np.ndarray, "goals"] | None:
        if self.voyage is None:
            return None
        return np.flatnonzero(self.voyage.policy.goal).astype(np.int32)
