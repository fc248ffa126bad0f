import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import xarray as xr
from jaxtyping import Bool, Float, Int

from ...base import memory
from ...base.quantities import derived
from ...mapping import Chain
from ...space import estimates
from ..beaches import Stranded
from ..chains import phases
from ..closed_sets import ClosedSets
from ..deploy import (
    CoverageCurve,
    Deployment,
    VisibleDeployment,
    coverage_curve,
    deployment_cells,
    minimum_deployment,
    visible_deployment,
)
from ..flow import Flow, check_step, crossing_time
from ..reachability import reachable_at_depth, reachable_by_layer
from ..regions import Exchange
from ..truth.distance import nearest_maps
from ..voyage import Voyage, discounted_voyage, surest_voyage
from ..water import Water
from .layer import Layer
from .sea_currents import SeaCurrents
from .sea_voyage import SeaVoyage


# The curve of so many cells takes seconds.
_MAX_FOR_CURVE = 20_000
# The solves for more cells at all phases take minutes.
_MAX_STATES = 2_500_000
# So many remarks are for a screen.
_MAX_REMARKS = 4
_SQUARES = "layer y x"


@dataclasses.dataclass(frozen=True, eq=False)
class SeaDrift(SeaCurrents):
    """What becomes of drifters in some layers of the sea, and where to drop them.

    What is not asked for is not computed. The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> found = drift.SeaDrift.of(currents)
        >>> found.cells, found.depths, round(found.step / 60), found.persistent_groups
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
        *("persistent_groups", "mean_leaving", "median_hours", "drifters_left", "distance_24h"),
        *("distance_6h", "map_left", "compared_hours", "compared_cells"),
        *("drifter_count", "fewest_count", "cells", "step"),
        *("period_hours", "reached_cells", "reached_cells_at_any_depth", "views_least", "view"),
    )

    start: int | None = None
    "The cell of the surface where a drifter is dropped."
    reach: float | None = None
    "How far drifters that look at the sea bed see, in metres."
    seconds: float | int | None = None
    "For how long to look for the fewest views; `None` for greedy ones."
    voyage: SeaVoyage | None = None
    "The way to a goal, by the discounted policy."
    surest: SeaVoyage | None = None
    "The way that most likely arrives."
    exchange: Exchange | None = None
    "How drifters go between regions of the surface."
    beaching: Stranded | None = None
    "Drifters of the surface that strand at coasts."
    nearly_closed_sets: ClosedSets | None = None
    "Parts of the water that drifters hardly leave."
    notices: tuple[str, ...] = ()
    "What was done otherwise than asked for."

    def __post_init__(self) -> None:
        """**Raises:** `ValueError` for parts that are not of the same cells or layers."""
        super().__post_init__()
        surface = self.waters[0].cells
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
        duration: float | int | None = None,
        *,
        start: int | None = None,
        reach: float | None = None,
        seconds: float | int | None = None,
        mean: bool = False,
        backward: bool = False,
        diffusivity: float | int = 0.0,
        say: Callable[..., None] = lambda *_: None,
        **options: Any,
    ) -> "SeaDrift":
        """The long-term behaviour in each layer.

        A current of several records changes from one to the next, and after the last begins again
        with the first. Maps follow on one another, over a whole period, and groups and times are
        those of drifters that are released at the first record. Where that would take more than the
        free memory, or more than 2.5 million cells at all phases, the mean of the records is taken,
        and `remarks` say so.

        **Arguments:**

        - `currents`: as from [`jaxcell.drift.open_currents`][].
        - `duration`: of a step, in seconds, to which the nearest is taken that fits the period; by
            default the [`jaxcell.drift.nearest_step`][] for sampled maps, and for others the
            [`jaxcell.drift.crossing_time`][] of the slowest layer. It is 0.001 to 1000 of those.
        - `start`: the cell of the surface where a drifter is dropped.
        - `reach`: how far cameras see the sea bed, in metres.
        - `seconds`: for how long to look for the fewest of them; by default they are greedy.
        - `mean`: whether to map by the mean of the records, as if the current did not change.
        - `backward`: whether drifters go back in time from the last record, by the reversed flow.
        - `diffusivity`: in m²/s, of what the current does not resolve; for sampled maps.
        - `say`: called with what is being done.
        - `options`: further ones of [`jaxcell.drift.drift_map`][], such as one of
            `jaxcell.drift.METHODS`.

        **Raises:** `ValueError` for another duration, or as [`jaxcell.drift.drift_map`][].
        """
        count = range(currents.sizes["layer"])
        waters = [Water.of(currents, k) for k in count]
        flows = [Flow.of(currents, k, diffusivity=diffusivity) for k in count]
        notices = []
        if backward:
            flows = [flow.reversed() for flow in flows]
            whence = "where they end is where those came from that are in a cell then."
            notices.append(f"Drifters go backward in time, from the last record on: {whence}")
        flows = [flow.repeated() for flow in flows]
        means = [flow.mean() for flow in flows]
        by = means if mean else flows
        check_step(duration, max(map(crossing_time, waters, flows)))

        def planned() -> tuple[float, Any]:
            """The duration of a step, and the maps of it where they were made to choose it."""
            if duration is not None:
                return by[0].fitted(duration), None
            if options.get("spread") != "sampled":
                return by[0].fitted(max(map(crossing_time, waters, by))), None
            say("choosing the duration of a step")
            return nearest_maps(waters, flows, by, **options)

        if (records := currents.attrs.get("mean_of", 1)) > 1:
            notices.append(
                f"The current is the mean of {records} records, and so is what drifters go with: "
                "together they take more memory than there is."
            )
        step, made = planned()
        if by is not means and (why := _too_large(waters, phases(by[0], step))):
            notices.append(f"{why}; this is by the mean of the records, as if nothing changed.")
            by = means
            step, made = planned()
        if duration is not None and not np.isclose(step, duration):
            notices.append(
                f"A step takes {step:g} s in place of {duration:g} s, to fit the "
                f"{float(by[0].period or 0) / 3600:g} h after which the current repeats."
            )
        layers = []
        for k, water in enumerate(waters):
            say(f"mapping {water.cells:,} cells at {water.depth:g} m")
            known = None if made is None else made[k]
            layers.append(Layer.of(water, flows[k], step, by=by[k], made=known, **options))
        return cls(tuple(layers), currents, start, reach, seconds, notices=tuple(notices))

    def towards(self, goal: npt.ArrayLike | int, discount: float = 0.99) -> "SeaDrift":
        """The same with voyages to a goal.

        **Arguments:**

        - `goal`: a cell of those of all layers, several, or a mask over them.
        - `discount`: what a step later is worth.

        **Raises:** as [`jaxcell.drift.discounted_voyage`][] and [`jaxcell.drift.surest_voyage`][].
        """

        def on_sea(policy: Voyage) -> SeaVoyage:
            place = self.place(int(np.flatnonzero(policy.goal)[0]))
            return SeaVoyage(self.sea, policy, self.step / 3600, place, self.start)

        return dataclasses.replace(
            self,
            voyage=on_sea(discounted_voyage(self.sea, goal, discount)),
            surest=on_sea(surest_voyage(self.sea, goal)),
        )

    @property
    def answered(self) -> bool:
        return self.surest is None or self.surest.arrives

    @property
    def remarks(self) -> tuple[str, ...]:
        found = [*self.notices, *(remark for layer in self.layers for remark in layer.remarks)]
        if len(found) > _MAX_REMARKS:
            more = f"and {len(found) - _MAX_REMARKS} more of that kind, at other depths."
            found[_MAX_REMARKS:] = [more]
        if self._counts is not None and self._counts[1, 1] > self._counts[1, 0] > 0:
            found.append(
                f"At {self.depths[0]:g} m: by the centres of cells alone there are "
                f"{self._counts[1, 1]} persistent groups in place of {self._counts[1, 0]}: their "
                "number depends on the grid; that of nearly closed sets does so less."
            )
        ways = [way for way in (self.voyage, self.surest) if way is not None]
        if not all(way.policy_certified and way.times_certified for way in ways):
            found.append(
                "What is not certified of the voyages is beyond 64-bit numbers somewhere: an eddy "
                "holds drifters almost for ever. It may be right elsewhere, or by another duration."
            )
        if not self.answered:
            found.append("No policy brings a drifter from the start to the goal.")
        return tuple(found)

    @property
    def attributes(self) -> Mapping[str, Any]:
        source = self.currents.attrs["source"]
        return {
            "Conventions": "CF-1.8",
            "source": f"jaxcell; definitions of Alam 2018, chapter 5; currents of {source}",
        }

    @functools.cached_property
    def reachable(self) -> tuple[Bool[np.ndarray, "cells"], Bool[np.ndarray, "cells"]] | None:
        """What drifters from the start may come to: those that stay in their layers, and those that
        go up and down."""
        if self.start is None:
            return None
        return reachable_by_layer(self.sea, self.start), reachable_at_depth(self.sea, self.start)

    @functools.cached_property
    def deployment(self) -> Deployment:
        """Where to drop drifters at the surface."""
        return deployment_cells(self.layers[0].behaviour)

    @functools.cached_property
    def minimum(self) -> Int[np.ndarray, "fewest"]:
        """The fewest cells from which all those of the surface may be visited; in a current that
        repeats itself, as few as are found one after the other."""
        chain = self.layers[0].behaviour.chain
        if isinstance(chain, Chain):
            return minimum_deployment(chain)
        return np.sort(self.deployment.cells if self.curve is None else self.curve.cells)

    @functools.cached_property
    def curve(self) -> CoverageCurve | None:
        """How many cells a number of drifters may visit; `None` for more than 20,000 cells."""
        surface = self.layers[0]
        small = surface.behaviour.unrolled.cells <= _MAX_FOR_CURVE
        return coverage_curve(surface.behaviour.chain) if small else None

    @functools.cached_property
    def views(self) -> VisibleDeployment | None:
        """Where to drop drifters that look at the sea bed."""
        surface = self.layers[0]
        if self.reach is None:
            return None
        return visible_deployment(
            surface.water, self.reach, surface.begins.groups, seconds=self.seconds
        )

    @derived("", "drifters, group by group, that may visit each cell", kind="count")
    def drifter_count(self) -> int:
        return self.deployment.cells.size

    @derived("", "fewest found from which each cell may be visited", kind="count")
    def fewest_count(self) -> int:
        return self.minimum.size

    @derived("drifter", "cell to drop a drifter in", kind="index")
    def deployment_cell(self) -> Int[np.ndarray, "drifters"]:
        return self.deployment.cells

    @derived("drifter", "longitude", "degrees_east", standard_name="longitude")
    def deployment_lon(self) -> Float[np.ndarray, "drifters"]:
        return self._lon_lat(self.deployment.cells)[0]

    @derived("drifter", "latitude", "degrees_north", standard_name="latitude")
    def deployment_lat(self) -> Float[np.ndarray, "drifters"]:
        return self._lon_lat(self.deployment.cells)[1]

    @derived("drifter", "persistent group, -1 if transient", kind="index")
    def deployment_group(self) -> Int[np.ndarray, "drifters"]:
        return self.deployment.group

    @derived("drifter", "transient group, -1 if persistent", kind="index")
    def deployment_transient_group(self) -> Int[np.ndarray, "drifters"]:
        return self.deployment.transient_group

    @derived("drifter", "cells of its group that are reached first from it", kind="count")
    def deployment_gained(self) -> Int[np.ndarray, "drifters"]:
        return self.deployment.gained

    @derived("fewest", "cell of the smallest deployment", kind="index")
    def minimum_cell(self) -> Int[np.ndarray, "fewest"]:
        return self.minimum

    @derived("fewest", "longitude", "degrees_east", standard_name="longitude")
    def minimum_lon(self) -> Float[np.ndarray, "fewest"]:
        return self._lon_lat(self.minimum)[0]

    @derived("fewest", "latitude", "degrees_north", standard_name="latitude")
    def minimum_lat(self) -> Float[np.ndarray, "fewest"]:
        return self._lon_lat(self.minimum)[1]

    @derived("drifters", "cell to drop the first, second, ... drifter in", kind="index")
    def curve_cell(self) -> Int[np.ndarray, "drifters"] | None:
        return None if self.curve is None else self.curve.cells

    @derived("drifters", "cells visited from these and those before", kind="count", listed=True)
    def curve_covered(self) -> Int[np.ndarray, "drifters"] | None:
        return None if self.curve is None else self.curve.covered

    @derived("view", "cell from which the sea bed is seen", kind="index")
    def views_cell(self) -> Int[np.ndarray, "views"] | None:
        return None if self.views is None else self.views.cover

    @derived("view", "longitude", "degrees_east", standard_name="longitude")
    def views_lon(self) -> Float[np.ndarray, "views"] | None:
        return None if self.views is None else self._lon_lat(self.views.cover)[0]

    @derived("view", "latitude", "degrees_north", standard_name="latitude")
    def views_lat(self) -> Float[np.ndarray, "views"] | None:
        return None if self.views is None else self._lon_lat(self.views.cover)[1]

    @derived("view", "whether a drifter is dropped there", kind="flag")
    def views_kept(self) -> Bool[np.ndarray, "views"] | None:
        return None if self.views is None else np.isin(self.views.cover, self.views.cells)

    @derived("", "views that no cover does with less than", kind="count")
    def views_least(self) -> int | None:
        return None if self.views is None else self.views.least

    @derived("", "cell where the drifter is dropped", kind="index")
    def start_cell(self) -> int | None:
        return self.start

    @derived(_SQUARES, "by drifters that keep their depth", kind="flag")
    def reached(self) -> Bool[np.ndarray, "layers rows columns"] | None:
        return None if self.reachable is None else self.sea.on_squares(self.reachable[0], False)

    @derived(_SQUARES, "by going up and down too", kind="flag")
    def reached_at_any_depth(self) -> Bool[np.ndarray, "layers rows columns"] | None:
        return None if self.reachable is None else self.sea.on_squares(self.reachable[1], False)

    @derived("layer", "cells reached, by keeping the depth", kind="count", listed=True)
    def reached_cells(self) -> Int[np.ndarray, "layers"] | None:
        return None if self.reached is None else self.reached.sum(axis=(1, 2))

    @derived("layer", "cells reached, by going up and down too", kind="count", listed=True)
    def reached_cells_at_any_depth(self) -> Int[np.ndarray, "layers"] | None:
        if self.reached_at_any_depth is None:
            return None
        return self.reached_at_any_depth.sum(axis=(1, 2))

    @derived("goals", "cells of the goal", kind="index")
    def goal(self) -> Int[np.ndarray, "goals"] | None:
        if self.voyage is None:
            return None
        return np.flatnonzero(self.voyage.policy.goal).astype(np.int32)


def _too_large(waters: Sequence[Water], phases: int) -> str | None:
    """Why maps at so many phases cannot follow on one another; `None` if they can."""
    cells = [phases * water.cells for water in waters]
    needed, available = estimates.drift(cells), memory.free()
    if sum(cells) > _MAX_STATES:
        limit = f"and {_MAX_STATES:,} are as many as take minutes"
    elif available is not None and needed > available:
        limit = (
            f"which need about {memory.gigabytes(needed)} of memory, and "
            f"{memory.shortage(available)}"
        )
    else:
        return None
    return f"The current has {sum(cells):,} cells at its {phases} phases, {limit}"
