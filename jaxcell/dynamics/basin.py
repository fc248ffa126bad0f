import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.indices import check_whole
from ..base.quantities import derived, from_part, quantity
from ..mapping import PeriodicGroups
from ..mapping.peel import groups_on_host
from ..space.box import Box
from . import attractors as of_map
from .answers import answer_of, kind_of, rounded
from .arrival import mean_arrivals, means_over_cells
from .batches import slices, totals
from .boundary.edge_states import EdgeStates
from .boundary.resolution import DOUBTFUL, Trial, tried
from .imaging import OnBox, Say, changed_by_half_step, check_map, images_of_each, torn_axes
from .maps import Flow, Map
from .orbits import NONE, OUTSIDE, orbit_basins
from .remarks import remarks_on


@dataclasses.dataclass(frozen=True, eq=False)
class Basins(OnBox):
    """Attractors of a map in a box, and their basins: the cells that lead to each attractor."""

    title: ClassVar[str] = "Attractors and basins"
    tables: ClassVar[Mapping[str, str]] = {"attractor": "basins", "edge": "edge_states"}

    box: Box
    params: Any
    "The parameters of the map."
    image: Int[np.ndarray, "cells"]
    "The image of each cell: a cell, `box.outside` or `box.nowhere`."
    basin: Annotated[
        Int[np.ndarray, "cells"],
        quantity("cell", "attractor that the cell leads to, -1 for none", kind="index"),
    ]
    group: Annotated[
        Int[np.ndarray, "cells"],
        quantity("cell", "periodic group that the cell leads to", kind="index"),
    ]
    "The group that each cell leads to. Groups are ordered by lowest cell, with the two sinks last."
    step: Annotated[
        Int[np.ndarray, "cells"],
        quantity(
            "cell", "mappings to its group of cells; by orbits: to its attractor", kind="count"
        ),
    ]
    group_period: Int[np.ndarray, "groups"]
    "Number of cells in each group; there are no entries for the two sinks."
    several: Annotated[
        Bool[np.ndarray, "cells"],
        quantity("cell", "whether its group leads to several attractors, as a saddle", kind="flag"),
    ]
    left: Bool[np.ndarray, "cells"]
    "`True` for each cell whose orbit leaves the box."
    orbit: Float[np.ndarray, "attractors window axes"]
    "Successive points of one orbit on each attractor."
    sampled: Annotated[
        Float[np.ndarray, "attractors"],
        quantity("attractor", "orbits from random starts that end on it", kind="share"),
    ]
    "The share of orbits from `starts` that end on each attractor, to compare with `fraction`."
    starts: Float[np.ndarray, "starts axes"]
    "Random points of the box, the starts of the orbits that `sampled` counts."
    ends: Int[np.ndarray, "starts"]
    "The attractor on which the orbit from each of `starts` ends, or -1 if it ends on no attractor."
    attractor_cells: tuple[Int[np.ndarray, "_"], ...]
    "The cells of each attractor."
    period: Annotated[
        Int[np.ndarray, "attractors"],
        quantity(
            "attractor", "mappings after which an orbit is back, 0 if not within 127", kind="count"
        ),
    ]
    return_time: Annotated[
        Float[np.ndarray, "attractors"] | None,
        quantity("attractor", "time after which an orbit is back, 0 for a point", kind="time"),
    ]
    """The period of each cycle: 0 for equilibria of flows, and infinite if an orbit is not back
    within 127 mappings. For a flow, it is measured from orbits of 16,384 steps."""
    lower: Annotated[
        Float[np.ndarray, "attractors axes"],
        quantity("attractor axis", "lowest coordinates of the attractor", listed=True),
    ]
    upper: Annotated[
        Float[np.ndarray, "attractors axes"],
        quantity("attractor axis", "highest coordinates of the attractor", listed=True),
    ]
    settled: Annotated[
        bool, quantity("", "whether orbits reached the attractors and stay on them", kind="flag")
    ]
    changed: Annotated[
        float | None, quantity("", "images that differ with steps of half the length", kind="share")
    ]
    neutral: bool = False
    "`True` if an orbit that is back has a direction in which others neither approach nor leave it."
    torn: tuple[int, ...] = ()
    "The periodic axes at whose lower and upper ends the map has different values."
    duration: float | None = None
    "The duration of each mapping; `None` if it differs between cells, or if it is not defined."
    time: Annotated[
        Float[np.ndarray, "cells"] | None,
        quantity("cell", "time to its group of cells", kind="time"),
    ] = None
    "The time inside the box from each cell to its group; `None` if only `step` was computed."
    mean_steps: Annotated[
        Float[np.ndarray, "attractors"] | None,
        quantity("attractor", "mean mappings to the attractor", "mappings", kind="time"),
    ] = None
    """The mean over its cells by orbits, or if groups are exactly the attractors. Else the mean
    until orbits from `starts` first are in a cell of the attractor; NaN if that is not known."""
    mean_steps_error: Annotated[
        Float[np.ndarray, "attractors"] | None,
        quantity("attractor", "its standard error, 0 if over all cells", "mappings", kind="time"),
    ] = None
    mean_time: Annotated[
        Float[np.ndarray, "attractors"] | None,
        quantity("attractor", "mean time to the attractor", kind="time"),
    ] = None
    labels: tuple[str, ...] = ()
    "The names of the axes. Without names, the axes are called `x0`, `x1`, ..."
    follow: int = 0
    "Number of mappings outside the box after which a point counts as lost."
    map: Map | None = None
    "The map, kept because `trial` needs it; `None` for basins by orbits, or of several maps."
    edges: EdgeStates | None = None
    "The edge states on boundaries of basins, or `None` if they were not computed."

    edge_first = from_part("edges.first", "edge", "attractor on one side", kind="index")
    edge_second = from_part("edges.second", "edge", "attractor on the other side", kind="index")
    edge_period = from_part(
        "edges.period",
        "edge",
        "period in mappings, 0 if the state is no fixed point or cycle of points",
        kind="count",
    )
    edge_unstable = from_part(
        "edges.unstable", "edge", "unstable directions, -1 if unknown", "1", kind="index"
    )
    edge_point = from_part("edges.point", "edge axis", "a point of the state", listed=True)

    @derived("", "number of attractors", kind="count")
    def attractors(self) -> int:
        return len(self.attractor_cells)

    groups = from_part("group_period.size", "", "number of periodic groups", kind="count")

    @derived("", "cells of periodic groups", kind="count")
    def periodic_cells(self) -> int:
        return int(self.group_period.sum())

    @derived("", "most mappings to a group within the box", kind="count")
    def longest_step(self) -> int:
        each = (
            self.step[part][self.group[part] < self.groups].max(initial=0)
            for part in slices(self.box.size)
        )
        return int(max(each))

    @derived("attractor", "cells that lead to it", kind="share")
    def fraction(self) -> Float[np.ndarray, "attractors"]:
        return totals(self.basin, self.attractors) / self.box.size

    @derived("attractor", "cells of the attractor", kind="count")
    def cells_on(self) -> Int[np.ndarray, "attractors"]:
        return np.array([cells.size for cells in self.attractor_cells], np.int64)

    @derived("attractor", "kind of the attractor: point, cycle or neither", kind="text")
    def kind(self) -> list[str]:
        return [kind_of(self, k) for k in range(self.attractors)]

    @derived("attractor axis", "a point of the attractor", listed=True)
    def point(self) -> Float[np.ndarray, "attractors axes"]:
        return rounded(self.box, self.orbit[:, 0])

    @property
    def times(self) -> Float[np.ndarray, "cells"]:
        """Time from each cell to its group of cells, or by orbits to its attractor; see `step`."""
        return self.step * (self.duration or 1.0) if self.time is None else self.time

    @derived("", "random starts that end elsewhere than their cells lead", kind="share")
    def disagreement(self) -> float:
        return float(np.mean(self.basin[self.box.index(self.starts)] != self.ends))

    def share(self, mask: Callable[[slice], np.ndarray]) -> float:
        """Compute the share of cells in a mask; `mask(part)` is the mask of a slice of cells."""
        return sum(np.count_nonzero(mask(part)) for part in slices(self.box.size)) / self.box.size

    @derived("", "cells that lead out of the box", kind="share")
    def outside_share(self) -> float:
        return self.share(lambda part: self.left[part])

    @derived("", "cells that lead nowhere: not to a finite point, or to no attractor", kind="share")
    def nowhere_share(self) -> float:
        return self.share(lambda part: (self.basin[part] < 0) & ~self.left[part])

    @derived("", "cells that are their own images", kind="share")
    def self_images(self) -> float:
        return self.share(lambda part: self.image[part] == np.arange(part.start, part.stop))

    @derived("", "cells that lead to a saddle", kind="share")
    def several_share(self) -> float:
        return self.share(lambda part: self.several[part])

    @functools.cached_property
    def trial(self) -> Trial | None:
        """A test whether finer cells or orbits reduce a `disagreement` above 5 %; else `None`."""
        if self.map is None or self.disagreement <= DOUBTFUL:
            return None
        return tried(self.map, self)

    @property
    def answer(self) -> tuple[str, ...]:
        return answer_of(self)

    @property
    def remarks(self) -> tuple[str, ...]:
        return remarks_on(self)


def basins(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    follow: int = 0,
    dtype: Any = None,
    by: Literal["cells", "orbits"] = "cells",
    seed: int = 0,
    labels: tuple[str, ...] = (),
    say: Say | None = None,
) -> Basins:
    """Find the attractors of a map in a box, and the basin of each.

    It runs on the host, because attractors have different numbers of points.

    **Arguments:**

    - `map`, `box`, `params`, `follow`: as in [`jaxcell.dynamics.images`][].
    - `dtype`: data type of points, `float32` or `float64`; by default the widest enabled type.
    - `by`: the method that assigns attractors to cells: `"cells"`, the map of the cells, which
        takes one image per cell; or `"orbits"`, the orbit of each centre, which takes many images
        per cell, but is correct where cells are too coarse, such as near a chaotic attractor.
    - `seed`: seed of the random points from which orbits are followed to attractors.
    - `labels`: names of the axes.
    - `say`: a function that is called with the activity and its progress.

    **Returns:** [`Basins`][], the attractor of each cell.

    Warns, before cells are mapped, if the map differs at the two ends of a periodic axis.

    A particle in a double well comes to rest on the left or on the right:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> well = dynamics.flow(lambda x, p: jnp.array([x[1], x[0] - x[0] ** 3 - x[1]]), 0.05, 20)
        >>> basins = dynamics.basins(well, space.Box([-2, -2], [2, 2], cells=[40, 40]))
        >>> basins.attractors, basins.period.tolist(), basins.fraction.round(2).tolist()
        (2, [1, 1], [0.5, 0.5])
    """
    options: dict[str, Any] = {"follow": follow, "dtype": dtype, "by": by, "seed": seed}
    return basins_of_each(map, box, [params], labels=labels, say=say, **options)[0]


def basins_of_each(
    map: Map,
    box: Box,
    members: Sequence[Any],
    *,
    follow: int = 0,
    dtype: Any = None,
    by: Literal["cells", "orbits"] = "cells",
    scattered: int = of_map.SCATTERED,
    seed: int = 0,
    labels: tuple[str, ...] = (),
    timed: bool = True,
    say: Say | None = None,
) -> list[Basins]:
    """Compute [`basins`][jaxcell.dynamics.basins] for each set of parameters in `members`.

    Without `timed`, they have no mean times to attractors.
    """
    follow, seed = check_whole("follow", follow), check_whole("seed", seed)
    if by not in ("cells", "orbits"):
        raise ValueError(f"by: expected cells or orbits, got {by!r}")
    if dtype is not None:
        dtype = np.dtype(dtype).newbyteorder("=")
        if dtype not in (np.float32, np.float64):
            raise ValueError(f"dtype: expected float32 or float64, got {dtype}")
    check_map(map, box, members[0])
    torn = torn_axes(map, box, members, labels)
    duration = getattr(map, "duration", None)
    uneven = hasattr(map, "timed") or (isinstance(map, Flow) and map.crossing > 0)
    each_timed = uneven and by == "cells"
    time = np.empty((len(members), box.size), np.float32) if each_timed else None
    with_sinks = np.empty((len(members), box.size + 2), np.int32)
    image, with_sinks[:, -2:] = with_sinks[:, :-2], (box.outside, box.nowhere)
    images_of_each(map, box, members, follow=follow, dtype=dtype, out=image, time=time, say=say)
    if say is not None:
        say("finding groups and attractors", 0, 0)
    groups = [groups_on_host(images) for images in with_sinks]
    attractors = of_map.attractors(
        map, box, members, groups, follow=follow, scattered=scattered, seed=seed
    )
    changed = changed_by_half_step(map, box, members, image, follow=follow, dtype=dtype)
    about: dict[str, Any] = {"duration": duration, "labels": labels, "follow": follow}
    each: list[Basins] = []
    for params, ends, *parts in zip(members, torn, image, groups, attractors, changed, strict=True):
        basins = by_cells(box, params, *parts)
        known = {**about, "torn": ends}
        if time is not None:
            known["time"] = _time_sums(basins, time[len(each)])
        if by == "orbits":
            cells = basins.attractor_cells
            basin, step = orbit_basins(map, box, params, cells, follow=follow, say=say)
            known |= {"left": basin == OUTSIDE, "basin": np.maximum(basin, NONE), "step": step}
            known["several"] = np.zeros(box.size, bool)
        elif len(members) == 1:
            known["map"] = map
        basins = dataclasses.replace(basins, **known)
        if timed:
            means = means_over_cells(basins) if by == "orbits" else mean_arrivals(map, basins)
            basins = dataclasses.replace(basins, **means)
        each.append(basins)
    return each


def _time_sums(basins: Basins, lasts: Float[np.ndarray, "cells"]) -> Float[np.ndarray, "cells"]:
    """Sum the durations `lasts` of the mappings that lead from each cell to its group."""
    time = np.zeros(basins.box.size + 2)
    order = np.argsort(basins.step, kind="stable")
    ends = np.cumsum(np.bincount(basins.step))
    for cells in np.split(order, ends[:-1])[1:]:
        for chunk in slices(cells.size):
            part = cells[chunk]
            time[part] = lasts[part] + time[basins.image[part]]
    return time[:-2]


def by_cells(
    box: Box,
    params: Any,
    image: Int[np.ndarray, "cells"],
    groups: PeriodicGroups,
    attractors: of_map.Attractors,
    changed: float | None,
    new: Callable[[str, Any, int], np.ndarray] = lambda _, kind, size: np.empty(size, kind),
) -> Basins:
    """Build basins in which each cell leads to the attractor of its group.

    `new(name, dtype, size)` creates arrays over cells. `changed` is a field of [`Basins`][].
    """
    group, step = (np.asarray(x)[: box.size] for x in (groups.group, groups.step))
    basin = new("basin", np.int32, box.size)
    several, left = (new(name, bool, box.size) for name in ("several", "left"))
    for part in slices(box.size):
        end = attractors.of_group[group[part]]
        # A group whose orbits leave the box exists only among cells: cells that lead to it leave.
        left[part], several[part] = end == OUTSIDE, attractors.several[group[part]]
        basin[part] = np.maximum(end, NONE)
    order = np.argsort(-totals(basin, attractors.count), kind="stable")
    # The last entry, which -1 selects, stands for no attractor.
    rank = np.full(attractors.count + 1, NONE, np.int32)
    rank[order] = np.arange(attractors.count)
    for part in slices(box.size):
        basin[part] = rank[basin[part]]
    return Basins(
        box,
        params,
        image,
        basin=basin,
        group=group,
        step=step,
        # The sinks have the last two numbers of cells, and so of groups.
        group_period=np.asarray(groups.group_period[:-2]),
        several=several,
        left=left,
        orbit=attractors.orbit[order],
        sampled=attractors.sampled[order],
        starts=attractors.starts,
        ends=rank[attractors.ends],
        attractor_cells=tuple(attractors.cells[k] for k in order),
        period=attractors.period[order],
        return_time=None if attractors.return_time is None else attractors.return_time[order],
        lower=rounded(box, attractors.lower[order]),
        upper=rounded(box, attractors.upper[order]),
        settled=attractors.settled,
        neutral=attractors.neutral,
        changed=changed,
    )
