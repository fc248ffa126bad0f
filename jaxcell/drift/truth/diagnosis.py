import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from ...mapping import PersistentGroups, persistent_groups
from ..advection import carried, checked_duration, flow_map
from ..chains import drift_maps, phases
from ..flow import Flow
from ..water import Water, square


# A step over which the mean drift is so many cells is not too short.
_FAR = 2.0
# So many steps of the map are enough for water to leave a cell that is not its end.
_LONG = 10


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """How far the groups of a drift map can be trusted."""

    duration: float
    "Seconds that one step takes."
    mean_shift: float
    "How far the centres of the cells drift in one step, in cells, on average."
    self_image: float
    "The share of all cells whose centre stays in the cell."
    pieces: Int[np.ndarray, "pieces"]
    "Number of cells of each connected piece of water."
    whole_pieces: int
    "Number of persistent groups that are a whole piece of water: nothing of the flow made them."
    locked: int
    "Number of the other persistent groups that are one cell, out of which the water flows."
    ashore: int
    "Number of those that are one cell, out of which it flows onto land only."
    groups: int
    "Number of persistent groups."

    @property
    def warning(self) -> str | None:
        """A sentence if the grid, rather than the flow, made the groups; else none.

        On a grid a drift of less than half a cell is none, so a step that is too short makes slow
        cells persistent. It is too short here if more than half of the cells are their own images,
        or if more than half of the persistent groups, whole pieces of water apart, are locked:
        single cells from whose centre the flow itself leads out of the cell within ten steps.
        `remedies` says what may help.
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
        """The arguments of the map that may make its groups those of the water.

        A longer `duration`, if the mean drift is less than two cells; and another `spread`, which
        is `"sampled"`. None if there is no warning.

        **Arguments:**

        - `spread`: that of the map.
        """
        if self.warning is None:
            return ()
        longer = ("duration",) if self.mean_shift < _FAR else ()
        return longer if spread == "sampled" else (*longer, "spread")


def diagnose(
    water: Water,
    flow: Flow,
    groups: PersistentGroups,
    duration: float | int | None = None,
    *,
    start: float | int = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> Diagnosis:
    """Say how far the persistent groups of a drift map can be trusted.

    **Arguments:**

    - `water`, `flow`, `duration`, `start`, `method`, `steps`: those of the map.
    - `groups`: its persistent groups.

    **Returns:** [`Diagnosis`][], whose `warning` is for people.

    **Raises:** `ValueError` if the groups are of another map, or as [`jaxcell.drift.flow_map`][].

    The surface of the bundled sea, where the flow makes the groups:

        >>> from jaxcell import drift, examples, mapping
        >>> water, flow = examples.gyres()
        >>> groups = mapping.persistent_groups(drift.drift_map(water, flow))
        >>> found = drift.diagnose(water, flow, groups)
        >>> found.groups, found.locked, round(found.mean_shift, 2), found.warning
        (3, 0, 1.0, None)
    """
    if groups.group.shape[0] != water.cells:
        raise ValueError(
            f"groups: expected those of a map of {water.cells} cells, got those of one of "
            f"{groups.group.shape[0]}"
        )
    duration = checked_duration(flow, water, duration, method, steps)
    # At each phase of a current that repeats itself.
    right, up = np.stack(
        [
            flow_map(water, flow, duration, start=start + n * duration, method=method, steps=steps)
            for n in range(phases(flow, duration))
        ],
        axis=1,
    )
    image = water.landing(water.column + right, water.row + up)
    pieces = np.bincount(water.piece)
    group = np.asarray(groups.group)
    size = np.asarray(groups.size)
    _, first = np.unique(group[group >= 0], return_index=True)
    whole = size == pieces[water.piece[group >= 0][first]]
    alone = np.flatnonzero(group >= 0)[first][(size == 1) & ~whole]
    x, y = (v[alone].astype(np.float64) for v in (water.column, water.row))
    to = carried(flow, x, y, _LONG * duration, start, "rk4", 4 * _LONG * steps)
    locked = water.landing(to[0][None], to[1][None], origin=alone, exits=True)[0] != alone
    # What runs ashore is in the nearest cell, as in the map, though it may be off the square.
    cell, _ = water.at(*square(*to))
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


def group_counts(
    water: Water,
    flow: Flow,
    durations: Sequence[float | int],
    rhos: Sequence[float | int] = (1.0, 0.8),
    **options: Any,
) -> Int[np.ndarray, "durations rhos"]:
    """The number of persistent groups, for several steps and probabilities of the image.

    Which cells lead to which depends on whether `rho` is 0, 1 or neither, and so do the groups; how
    soon drifters are in them depends on all of it.

    **Arguments:**

    - `water`, `flow`: as for [`jaxcell.drift.drift_map`][].
    - `durations`: of a step, in seconds; for a flow that repeats, those that fit are taken.
    - `rhos`: probabilities of the image.
    - `options`: further ones of [`jaxcell.drift.drift_map`][].

    **Returns:** a row for each duration, a column for each probability.

    **Raises:** `ValueError` as [`jaxcell.drift.drift_map`][].

    The surface of the bundled sea, with steps of half an hour and an hour:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> drift.group_counts(water, flow, [1800, 3600], [1.0, 0.8]).tolist()
        [[3, 3], [3, 1]]
    """
    return np.array(
        [
            [
                persistent_groups(drift_maps(water, flow, duration, rho=rho, **options)).count
                for rho in rhos
            ]
            for duration in map(flow.fitted, durations)
        ]
    ).reshape(len(durations), len(rhos))
