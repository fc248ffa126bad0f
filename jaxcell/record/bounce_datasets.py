from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Int

from ..automata import Filter
from ..bounce import Localization
from ..mapping import PeriodicGroups
from ..space import CellSpace
from .checks import filter_checks, groups_checks, localization_checks, with_checks
from .provenance import angle_attributes, cell_coordinates, provenance
from .tables import check_filter, group_table, host_groups


def groups_dataset(
    cells: CellSpace,
    groups: PeriodicGroups,
    *,
    bounce: Float[np.ndarray, "*batch"] | Array | float,
    image: Int[Array, "*batch cells"] | None = None,
    spec: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """The periodic groups of bounce maps as a labelled dataset.

    Over the dimensions `direction` and `position`, and `bounce` before them if there are several
    angles: `group`, `step`, `period` and `periodic`. Over `group_index`: `group_period`,
    `group_basin` (cells that reach the group) and `group_transient` (mappings from the farthest of
    them); where one angle has fewer groups than another, its last entries are -1.

    `dataset.group.sel(direction=0).set_index(position=("y", "x")).unstack()` is the picture of one
    direction.

    **Arguments:**

    - `cells`: the cell space.
    - `groups`: the groups of one bounce map, or of a batch.
    - `bounce`: the bouncing angle of each, in radians.
    - `image`: the image of every cell, against which the groups are checked then.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the groups are not of these cells, or not one for each angle, or if
    `spec` is not JSON; `RuntimeError` if they contradict themselves or the images.

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> from jaxcell import bounce, mapping, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> image = bounce.bounce_map(cells, math.pi / 2).image
        >>> groups = mapping.periodic_groups(image)
        >>> dataset = record.groups_dataset(cells, groups, bounce=math.pi / 2)
        >>> dict(dataset.sizes), dataset.group_period.values.tolist()
        ({'direction': 4, 'position': 3, 'group_index': 1}, [8])
    """
    angles, host = host_groups(cells, groups, bounce)
    tables = [group_table(cells, one) for one in host]
    most = max(len(table.period) for table in tables)
    batch = ("bounce",) if np.ndim(bounce) else ()
    shape = angles.shape if batch else ()

    def over_cells(name: str, meaning: str, **attributes: str) -> tuple[Any, ...]:
        values = np.stack([getattr(one, name) for one in host])
        values = values.reshape(*shape, cells.directions, cells.positions)
        return (*batch, "direction", "position"), values, {"long_name": meaning, **attributes}

    def over_groups(name: str, meaning: str, units: str) -> tuple[Any, ...]:
        values = np.full((len(tables), most), -1, np.int32)
        for row, table in zip(values, tables, strict=True):
            row[: len(table.period)] = getattr(table, name)
        attributes = {"long_name": meaning, "units": units, "padding": "-1: no such group"}
        return (*batch, "group_index"), values.reshape(*shape, most), attributes

    dataset = xr.Dataset(
        {
            "group": over_cells("group", "periodic group that the cell reaches"),
            "step": over_cells("step", "mappings until the cell is on its group", units="mappings"),
            "period": over_cells("period", "period of that group", units="mappings"),
            "periodic": over_cells("periodic", "whether the cell is on its group"),
            "group_period": over_groups("period", "period of the group", "mappings"),
            "group_basin": over_groups("basin", "cells that reach the group", "cells"),
            "group_transient": over_groups("transient", "longest transient", "mappings"),
            "groups": (batch, np.array([len(t.period) for t in tables], np.int32).reshape(shape)),
        },
        coords={
            "bounce": (batch, angles.reshape(shape), angle_attributes("bouncing angle")),
            "bounce_deg": (batch, np.rad2deg(angles).reshape(shape), {"units": "degree"}),
            **cell_coordinates(cells),
        },
        attrs=provenance("Periodic groups of a bouncing robot", cells, spec),
    )
    known = None if image is None else np.asarray(image)
    return with_checks(dataset, groups_checks(dataset, known))


def filter_dataset(filter: Filter, *, spec: Mapping[str, Any] | None = None) -> xr.Dataset:
    """A localization filter as a labelled dataset.

    Over `state`: `transition` (by `observation` too; -1 where there is none), `color` and
    `uncertainty`. The configurations of state `s` are `member[offset[s]:offset[s + 1]]`. Over
    `cycle`, the knowledge cycles: `cycle_color`, `cycle_uncertainty`, and their states, in order
    and one cycle after the other, in `cycle_state[cycle_offset[c]:cycle_offset[c + 1]]`.

    **Arguments:**

    - `filter`: the filter.
    - `spec`: what was asked for, by default the metadata of the filter.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> filter = bounce.localization_filter(bounce.bounce_map(cells, math.pi / 2))
        >>> dataset = record.filter_dataset(filter)
        >>> dataset.transition.sizes["state"], dataset.uncertainty[:3].values.tolist()
        (8, [12, 4, 8])
    """
    dataset = xr.Dataset(
        _filter_variables(filter),
        coords={"observation": ("observation", np.arange(2, dtype=np.int32), _OBSERVATION)},
        attrs=provenance("Localization filter of a bouncing robot", None, spec or filter.metadata),
    )
    return with_checks(dataset, filter_checks(dataset))


def localization_dataset(
    cells: CellSpace,
    filter: Filter,
    localization: Localization,
    *,
    spec: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """A localization filter and a robot that it localized, as a labelled dataset.

    What [`jaxcell.record.filter_dataset`][] holds, and the run: over `time`, from the start,
    `cell` with its `x`, `y` and `theta`, `state`, `belief_size` and `belief_color`; over `time`
    too, but for the last, `sensed`; and the `candidate` cells at the end.

    **Arguments:**

    - `cells`: the cell space.
    - `filter`: the filter.
    - `localization`: the run.
    - `spec`: what was asked for, by default the metadata of the filter.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the filter or the run are not of these cells; `RuntimeError` if they
    contradict each other.

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> found = bounce.bounce_map(cells, math.pi / 2)
        >>> filter = bounce.localization_filter(found)
        >>> run = bounce.localize(found, filter, start=0)
        >>> dataset = record.localization_dataset(cells, filter, run)
        >>> dataset.sensed.values.tolist(), dataset.belief_size.values.tolist()
        ([0, 0], [12, 4, 2])
    """
    check_filter(cells, filter, localization)
    x, y, theta = cells.centre(localization.path)
    candidate_x, candidate_y, candidate_theta = cells.centre(localization.candidates)
    states = localization.states
    metres = {"units": "m"}
    dataset = xr.Dataset(
        {
            **_filter_variables(filter),
            "cell": ("time", localization.path, {"long_name": "cell that the robot is in"}),
            "x": ("time", x, metres),
            "y": ("time", y, metres),
            "theta": ("time", theta, angle_attributes("heading")),
            "visited": ("time", states, {"long_name": "state of the filter"}),
            "belief_size": (
                "time",
                filter.uncertainty[states],
                {"long_name": "cells where the robot may be", "units": "cells"},
            ),
            "belief_color": ("time", filter.color[states], {"long_name": "colour of the filter"}),
            "sensed": ("move", localization.observations.astype(np.int32), _OBSERVATION),
            "candidate": ("candidates", localization.candidates),
            "candidate_x": ("candidates", candidate_x, metres),
            "candidate_y": ("candidates", candidate_y, metres),
            "candidate_theta": ("candidates", candidate_theta, angle_attributes("heading")),
        },
        coords={
            "observation": ("observation", np.arange(2, dtype=np.int32), _OBSERVATION),
            "time": ("time", np.arange(len(states), dtype=np.int32), {"units": "mappings"}),
        },
        attrs=provenance(
            "Localization of a bouncing robot by its bumps", cells, spec or filter.metadata
        ),
    )
    return with_checks(dataset, localization_checks(dataset))


_OBSERVATION = {"long_name": "what the robot senses", "meaning": "0: it moved, 1: it bumped"}


def _filter_variables(filter: Filter) -> dict[str, tuple[Any, ...]]:
    lengths = [len(cycle.states) for cycle in filter.cycles]
    cycle_state = [cycle.states for cycle in filter.cycles]
    cycle_color = [cycle.color for cycle in filter.cycles]
    cycle_uncertainty = [cycle.uncertainty for cycle in filter.cycles]
    none = {"padding": "-1: that observation cannot occur"}
    return {
        "transition": (("state", "observation"), filter.transition, none),
        "color": ("state", filter.color, {"long_name": "colour: 1 outside the knowledge cycles"}),
        "uncertainty": (
            "state",
            filter.uncertainty,
            {"long_name": "cells where the robot may be", "units": "cells"},
        ),
        "offset": ("state_bound", filter.offsets, {"long_name": "where a state begins in member"}),
        "member": ("entry", filter.members, {"long_name": "cells of the states in turn"}),
        "cycle_color": ("cycle", np.array(cycle_color, np.int32)),
        "cycle_uncertainty": ("cycle", np.array(cycle_uncertainty, np.int32), {"units": "cells"}),
        "cycle_offset": ("cycle_bound", np.cumsum([0, *lengths], dtype=np.int64)),
        "cycle_state": ("cycle_entry", np.concatenate([*cycle_state, np.empty(0, np.int32)])),
    }
