import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from ...base.shown import Shown
from ...mapping import PersistentGroups, persistent_groups
from ..advection import carried
from ..drift_step import DriftStep
from ..flow import Flow
from ..maps import drift_maps, flow_map
from ..water import Water, square


# The mean drift, in cells, above which a longer duration is not advised.
_FAR = 2.0
# If the flow leads out of a cell, water from its centre leaves it within this number of steps.
_LONG = 10


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """Signs that the grid, rather than the flow, determines the groups of a drift map."""

    duration: float
    "Seconds per step."
    mean_shift: float
    "The mean drift of the centres of the cells in one step, in cells."
    self_image: float
    "The share of the cells that are their own images."
    pieces: Int[np.ndarray, "pieces"]
    "Number of cells of each connected piece of water."
    whole_pieces: int
    "Number of persistent groups that fill a whole connected piece of water."
    locked: int
    "Number of other persistent groups of a single cell, although water flows out of this cell."
    ashore: int
    "Number of persistent groups that are a single cell from which water flows onto land only."
    groups: int
    "Number of persistent groups."

    @property
    def warning(self) -> str | None:
        """A warning that the grid, rather than the flow, determines the groups; or `None`.

        A drift of less than half a cell maps a cell to itself, so a step that is too short makes
        slow cells persistent. A step counts as too short if more than half of the cells are their
        own images, or if more than half of the persistent groups are single cells from whose centre
        the flow leads to another cell within ten steps. Groups that are whole pieces of water are
        not counted.
        """
        others = self.groups - self.whole_pieces
        if self.self_image > 0.5:
            why = f"{self.self_image:.0%} of the cells are mapped to themselves"
        elif 2 * self.locked > others:
            why = f"{self.locked} of {others} persistent groups are cells that water flows out of"
        else:
            return None
        return (
            f"{why}: the grid, and not the water, made the groups at a step of "
            f"{self.duration / 3600:.3g} h (mean drift {self.mean_shift:.2f} cells)"
        )

    def remedies(self, spread: str) -> tuple[str, ...]:
        """Return the names of the parameters of a step whose change may remove the warning.

        A longer `duration` may help if the mean drift is less than two cells, and `"sampled"` may
        help if it is not the `spread` already.
        """
        if self.warning is None:
            return ()
        longer = ("duration",) if self.mean_shift < _FAR else ()
        return longer if spread == "sampled" else (*longer, "spread")


def diagnose(water: Water, flow: Flow, groups: PersistentGroups, step: DriftStep) -> Diagnosis:
    """Diagnose whether the persistent groups of a drift map can be trusted.

    **Arguments:**

    - `water`, `flow`, `step`: the arguments with which the map was made.
    - `groups`: the persistent groups of the map.

    **Returns:** [`Diagnosis`][].

    The surface of the bundled sea, where the flow determines the groups:

        >>> from jaxcell import drift, examples, mapping
        >>> water, flow = examples.gyres()
        >>> step = drift.DriftStep()
        >>> groups = mapping.persistent_groups(drift.drift_map(water, flow, step))
        >>> diagnosis = drift.diagnose(water, flow, groups, step)
        >>> diagnosis.groups, diagnosis.locked, round(diagnosis.mean_shift, 2), diagnosis.warning
        (3, 0, 1.0, None)
    """
    if groups.group.shape[0] != water.cells:
        raise ValueError(
            f"groups: expected those of a map of {water.cells} cells, got those of one of "
            f"{groups.group.shape[0]}"
        )
    duration = step.seconds(water, flow)
    starts = np.arange(flow.phases(duration)) * duration
    step = step.lasting(duration)
    right, up = np.stack([flow_map(water, flow, step, start=t) for t in starts.tolist()], axis=1)
    image = water.landing(water.column + right, water.row + up)
    pieces = np.bincount(water.piece)
    group, size = np.asarray(groups.group), np.asarray(groups.size)
    persistent = np.flatnonzero(group >= 0)
    _, first = np.unique(group[persistent], return_index=True)
    smallest = persistent[first]
    whole = size == pieces[water.piece[smallest]]
    alone = smallest[(size == 1) & ~whole]
    x, y = (place[alone].astype(np.float64) for place in (water.column, water.row))
    end = carried(flow, x, y, _LONG * duration, 0.0, "rk4", 4 * _LONG * step.substeps)
    locked = water.landing(end[0][None], end[1][None], origin=alone, exits=True)[0] != alone
    # Drifters that run ashore are assigned to the nearest cell, as in the map, although their point
    # may be in another square.
    cell, _ = water.at(*square(*end))
    return Diagnosis(
        duration=duration,
        mean_shift=float(np.hypot(right, up).mean()),
        self_image=float((image == np.arange(water.cells)).mean()),
        pieces=pieces,
        whole_pieces=int(whole.sum()),
        locked=int(locked.sum()),
        ashore=int((~locked & (cell != alone)).sum()),
        groups=groups.count,
    )


def group_counts(water: Water, flow: Flow, steps: Sequence[DriftStep]) -> Int[np.ndarray, "steps"]:
    """Count the persistent groups of several drift maps, each made with one of the `steps`.

    The groups follow from the possible moves, not from their probabilities, so all values of `rho`
    between 0 and 1 give the same groups.

    **Arguments:**

    - `water`, `flow`: as for [`jaxcell.drift.drift_maps`][].
    - `steps`: the steps; in a periodic flow their durations are changed to fit the period.

    **Returns:** the number of groups for each step.

    The surface of the bundled sea, with steps of half an hour and an hour:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> steps = [drift.DriftStep(seconds, rho=1.0) for seconds in (1800, 3600)]
        >>> drift.group_counts(water, flow, steps).tolist()
        [3, 3]
    """
    fitted = (step.lasting(flow.fitted(step.seconds(water, flow))) for step in steps)
    return np.array([persistent_groups(drift_maps(water, flow, step)).count for step in fitted])
