import dataclasses
import functools
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from .. import markov
from ..base.quantities import Result, derived
from ..mapping import Chain, ChainSequence
from ..mapping.sequence import push_on_host
from ..markov import NearlyClosedSets
from .advection import longest_step
from .drift_step import METHODS
from .flow import Flow, steps_in
from .maps import drift_map, refined
from .matched_ranks import basin_ranks
from .water import Water


# Connected pieces of water with a smaller share of the cells are left out, though they are closed.
_LEAST_PIECE = 0.01
# A set that loses at least this share of its drifters in the window is not nearly closed.
_MOST_LEAKAGE = 0.5
# Products with the window in a long search, and entries of matrices that a processor multiplies in
# a second; measured on 160,000 cells of closed eddies.
_PRODUCTS, _ENTRIES = 1000, 4e8


def nearly_closed_sets(
    water: Water,
    chain: Chain | ChainSequence,
    duration: float | int,
    count: int,
    *,
    hours: float | int = 24.0,
) -> NearlyClosedSets:
    """Find almost-invariant sets: sets of cells that few drifters leave within `hours`.

    A set is not a persistent group if even one drifter can leave it, so persistent groups depend on
    the duration of a step. The share of the drifters that leave a set in a day hardly depends on
    this duration. Drifters are released with uniform density in space, and spread over the
    neighbouring cells at the end, because otherwise single cells in the middles of eddies would be
    found. Connected pieces of water with less than a hundredth of the cells are left out, and so
    are sets that lose half of their drifters or more.

    **Arguments:**

    - `water`: the cells.
    - `chain`: the map, from [`jaxcell.drift.drift_maps`][].
    - `duration`: seconds per step.
    - `count`: the number of sets to find; fewer may be returned.
    - `hours`: the time for which drifters drift, rounded to whole periods of a current whose
        period is at most this long, and otherwise to whole steps. Those that are then outside
        their set have left it.

    **Returns:** [`jaxcell.markov.NearlyClosedSets`][] for drifters that are released at phase 0.

    The bundled sea at its first record has three eddies; the two in the East make up one set:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(3600.0))
        >>> sets = drift.nearly_closed_sets(water, chain, 3600.0, 2)
        >>> sets.count, sets.steps
        (2, 24)
    """
    area, steps = water.sides.prod(axis=0), _window(chain, duration, hours)
    mass = np.where(np.bincount(water.piece)[water.piece] < _LEAST_PIECE * water.cells, 0.0, area)
    found = markov.almost_invariant_sets(chain, count, mass, steps=steps, blur=_blur(water))
    kept = found.leakage < _MOST_LEAKAGE
    number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1).astype(np.int32)[found.begin]
    return dataclasses.replace(found, begin=number, end=number, leakage=found.leakage[kept])


def _window(chain: Chain | ChainSequence, duration: float | int, hours: float | int) -> int:
    """Return the number of steps in a window of about `hours`."""
    steps = steps_in(hours * 3600, duration)
    phases = chain.phases if isinstance(chain, ChainSequence) else 1
    return steps if steps < phases else phases * steps_in(hours * 3600, duration * phases)


def closed_sets_seconds(
    chain: Chain | ChainSequence, duration: float | int, *, hours: float | int = 24.0
) -> float:
    """Foretell the seconds of a long search for nearly closed sets, on one processor.

    **Arguments:** as for [`nearly_closed_sets`][jaxcell.drift.nearly_closed_sets]. **Returns:** the
    seconds; most searches take a tenth of them.

    Four cells:

        >>> from jaxcell import drift, examples
        >>> drift.closed_sets_seconds(examples.stream(), 3600.0) < 1
        True
    """
    entries = int(np.count_nonzero(np.asarray(chain.probability)))
    phases = chain.phases if isinstance(chain, ChainSequence) else 1
    return 2 * _PRODUCTS * _window(chain, duration, hours) * entries / phases / _ENTRIES


def coherent_sets(
    water: Water,
    flow: Flow,
    hours: float | int,
    count: int | None = None,
    *,
    start: float | int = 0.0,
    steps: int = 1,
    most: int = 12,
) -> NearlyClosedSets:
    """Find coherent sets: water that moves together, and hardly mixes with its surroundings.

    This applies [`jaxcell.markov.coherent_sets`][] to a window of time; the current need not be
    periodic. Two choices are needed to find vortices. First, the window is mapped in few steps,
    preferably in one, because the grid spreads drifters by up to a cell in every step. Second,
    drifters are spread over the neighbouring cells at the end of the window, because otherwise
    single cells are the most coherent sets.

    **Arguments:**

    - `water`, `flow`: the cells, and the flow of the same layer at all records.
    - `hours`: the length of the window.
    - `count`: the number of sets; by default the number of singular values, from 2 to `most`,
        that lie above the largest gap between two successive ones.
    - `start`: the beginning of the window, in seconds as in `Flow.time`.
    - `steps`: the number of steps in which the window is mapped.
    - `most`: the largest number of sets that is tried if there is no `count`.

    **Returns:** [`jaxcell.markov.NearlyClosedSets`][], with the cells of each set at the beginning
    of the window, `begin`, and at its end, `end`.

    The surface of the bundled sea at its first record, which has three eddies:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> sets = drift.coherent_sets(water, flow, 12)
        >>> sets.count, bool(sets.leakage.max() < 0.1)
        (3, True)
    """
    length = 3600 * hours / steps
    step = refined(METHODS["drifters"], length, length / longest_step(water, flow))
    chains = [drift_map(water, flow, step, start=start + k * length) for k in range(steps)]
    window, area, blur = ChainSequence.of(chains), water.sides.prod(axis=0), _blur(water)

    def find(number: int) -> NearlyClosedSets:
        return markov.coherent_sets(window, number, area, steps=steps, blur=blur)

    if count is not None:
        return find(count)
    value = find(min(most + 1, water.cells)).value
    return find(2 + int(np.argmin(np.diff(value[1:]))))


def _blur(water: Water) -> Chain:
    """Build a chain that spreads the drifters of each cell over the cell and its neighbours."""
    every = np.arange(water.cells, dtype=np.int32)
    around = np.vstack([every, np.where(water.neighbor >= 0, water.neighbor, every)])
    return Chain(around, np.full(around.shape, 1 / len(around)))


@dataclasses.dataclass(frozen=True, eq=False)
class ClosedSets(Result):
    """The nearly closed sets of each layer: sets of cells that few drifters leave.

    Two cells that a drifter in 1000 leaves in an hour, and in a day 23 of 1000:

        >>> import numpy as np
        >>> from jaxcell import drift, examples, mapping
        >>> water = examples.water([[1, 1]])
        >>> chain = mapping.Chain.from_scipy(np.array([[0.999, 0.001], [0.001, 0.999]]))
        >>> sets = drift.ClosedSets.of([water], [chain], 3600.0, 2)
        >>> sets.number.tolist(), sets.leakage.round(3).tolist(), sets.window_hours
        ([[[0, 1]]], [0.023, 0.023], 24.0)
    """

    tables: ClassVar = {"closed_set": "sets"}

    waters: tuple[Water, ...]
    "The cells of each layer."
    layers: tuple[NearlyClosedSets, ...]
    "The sets of each layer."
    ended: tuple[Float[np.ndarray, "_cells"], ...]
    "For each layer, the share in each cell after the window of drifters released uniformly."
    duration: float | int
    "Seconds per step."

    @classmethod
    def of(
        cls,
        waters: Sequence[Water],
        chains: Sequence[Chain | ChainSequence],
        duration: float | int,
        count: int,
        hours: float | int = 24.0,
    ) -> "ClosedSets":
        """Find the sets of each layer, as [`nearly_closed_sets`][] does."""
        sets = [
            nearly_closed_sets(water, chain, duration, count, hours=hours)
            for water, chain in zip(waters, chains, strict=True)
        ]
        areas = [water.sides.prod(axis=0) for water in waters]
        ended = [
            push_on_host(chain, area / area.sum(), found.steps)
            for chain, area, found in zip(chains, areas, sets, strict=True)
        ]
        return cls(tuple(waters), tuple(sets), tuple(ended), duration)

    @derived("", "window in which they leak", "h", kind="time")
    def window_hours(self) -> float:
        return self.layers[0].steps * self.duration / 3600

    @derived("closed_set", "number on maps", kind="index")
    def rank(self) -> Int[np.ndarray, "sets"]:
        return np.concatenate(self.ranks)

    @derived("closed_set", "depth", "m")
    def depth(self) -> Float[np.ndarray, "sets"]:
        return np.concatenate([np.full(s.count, w.depth) for w, s in self._pairs])

    @derived("closed_set", "cells", kind="count")
    def size(self) -> Int[np.ndarray, "sets"]:
        return np.concatenate([np.bincount(s.begin + 1, minlength=1)[1:] for s in self.layers])

    @derived("closed_set", "drifters that are outside it after the window", "1", kind="share")
    def leakage(self) -> Float[np.ndarray, "sets"]:
        return np.concatenate([s.leakage for s in self.layers])

    @derived(
        "closed_set",
        "mean longitude of the drifters in it after the window",
        "degrees_east",
        standard_name="longitude",
    )
    def lon(self) -> Float[np.ndarray, "sets"]:
        return self._centres[:, 0]

    @derived("closed_set", "mean latitude", "degrees_north", standard_name="latitude")
    def lat(self) -> Float[np.ndarray, "sets"]:
        return self._centres[:, 1]

    @functools.cached_property
    def _centres(self) -> Float[np.ndarray, "sets 2"]:
        """The mean longitude and latitude of the drifters in each set after the window."""
        centres = [
            water.centre(np.where(found.begin == number, ended, 0.0))
            for (water, found), ended in zip(self._pairs, self.ended, strict=True)
            for number in range(found.count)
        ]
        return np.reshape(np.array(centres, float), (-1, 2))

    @derived("layer y x", "nearly closed set, -1 for none", kind="index", padding="-2: no water")
    def number(self) -> Int[np.ndarray, "layers rows columns"]:
        return np.stack(
            [w.on_grid(label, -2) for w, label in zip(self.waters, self.labels, strict=True)]
        )

    @functools.cached_property
    def ranks(self) -> list[Int[np.ndarray, "_sets"]]:
        """The label of each set in pictures, by layer; sets one above another share a label."""
        return basin_ranks([water.on_grid(sets.begin, -1) for water, sets in self._pairs])

    @functools.cached_property
    def labels(self) -> list[Int[np.ndarray, "_cells"]]:
        """For each layer, the number of the set that contains each cell, or -1."""
        first = np.cumsum([0, *(s.count for s in self.layers)])
        pairs = zip(self.layers, first[:-1].tolist(), strict=True)
        return [np.where(s.begin < 0, -1, s.begin + before) for s, before in pairs]

    @property
    def _pairs(self) -> list[tuple[Water, NearlyClosedSets]]:
        return list(zip(self.waters, self.layers, strict=True))
