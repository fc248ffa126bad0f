import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.quantities import derived
from ...mapping import Chain, persistent_groups
from ...mapping.sequence import push_on_host
from ...markov import absorption_times, limiting_distribution
from ..behaviour import long_term_behaviour
from ..closed_sets import ClosedSets
from ..ends import LayerEnds
from ..flow import steps_in
from ..results.sea_layers import SeaLayers
from .counted import CountedMoves, Spread, bootstrap
from .trajectories import Trajectories


_SQUARES = "layer y x"
_LAND = "NaN: too few drifters were there"
# What is asked of each resampled chain, of the whole and then of every cell.
_OF_ALL = "persistent groups", "cells of persistent groups", "median hours to the end", "share left"
_OF_CELLS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class ObservedDrift(SeaLayers):
    """What becomes of drifters by the moves of those that were observed, and how sure that is.

    A hundred drifters of which 60 go on to the East, and then off the map:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> lon = np.stack([np.full(100, 0.5), 0.5 + (np.arange(100) < 60)], axis=1).ravel()
        >>> time, number = np.tile([0.0, 86400.0], 100), np.arange(100).repeat(2)
        >>> seen = drift.Trajectories.of(lon, 0 * lon + 0.5, time, number)
        >>> moves = drift.count_moves(seen, drift.boxes(seen, 1.0), 86400.0)
        >>> found = drift.ObservedDrift.of(seen, moves, samples=20)
        >>> error = float(np.nanmax(found.absorption_time_error))
        >>> found.cells, round(found.median_hours), round(error)
        (1, 40, 4)
    """

    title: ClassVar[str] = "Long-term behaviour of drifters that were observed"
    tables: ClassVar[Mapping[str, str]] = {"estimate": "estimates"}
    brief: ClassVar[tuple[str, ...]] = (
        *("persistent_groups", "mean_leaving", "median_hours", "drifters", "observations", "moves"),
        *("cells", "step", "estimate"),
    )

    seen: Trajectories
    "The trajectories."
    counted: CountedMoves
    "Their moves between cells."
    spread: Spread
    "Of what was asked of the chains of resampled drifters."
    nearly_closed_sets: ClosedSets | None = None
    "Parts of the water that drifters hardly leave."
    after: float | int | None = None
    "Seconds after which it is asked where drifters are; in the long run, if `None`."

    @classmethod
    def of(
        cls,
        seen: Trajectories,
        moves: CountedMoves,
        *,
        after: float | int | None = None,
        sets: int | None = None,
        samples: int = 100,
        seed: int = 0,
        say: Callable[..., None] = lambda *_: None,
    ) -> "ObservedDrift":
        """The long-term behaviour by the chain of moves.

        **Arguments:**

        - `seen`, `moves`: the trajectories, and their moves from [`jaxcell.drift.count_moves`][].
        - `after`: seconds after which it is asked where drifters are; by default in the long run.
        - `sets`: how many nearly closed sets to find.
        - `samples`, `seed`: as for [`jaxcell.drift.bootstrap`][].
        - `say`: called with what is being done.

        **Raises:** as [`jaxcell.drift.bootstrap`][] and [`jaxcell.drift.nearly_closed_sets`][].
        """
        chain, water, lag = moves.chain, moves.water, float(moves.lag)
        closed = None if sets is None else ClosedSets.of([water], [chain], lag, sets)
        done = itertools.count()

        def asked(chain: Chain) -> Float[np.ndarray, "answers"]:
            say("drawing drifters anew", next(done), samples + 1)
            return _answers(chain, lag, after, closed)

        spread = bootstrap(moves, asked, samples, seed)
        layer = LayerEnds(water, long_term_behaviour(chain, lag))
        return cls((layer,), seen, moves, spread, closed, after)

    @property
    def remarks(self) -> tuple[str, ...]:
        found = self.layers[0].remarks
        if self.after is None and not self._of_cells(self.spread.value, 2).any():
            found += ("In the long run all drifters have left the map; --after asks earlier.",)
        return found

    @property
    def when(self) -> str:
        """When it is asked where drifters are."""
        return "in the long run" if self.after is None else f"after {self.after / 86400:g} days"

    @derived("", "drifters that were observed", kind="count")
    def drifters(self) -> int:
        return self.seen.drifters

    @derived("", "observations", kind="count")
    def observations(self) -> int:
        return self.seen.lon.size

    @derived("", "moves between cells", kind="count")
    def moves(self) -> int:
        return self.counted.begin.size

    @derived("", "trajectories of")
    def source(self) -> str:
        return self.seen.source

    @derived("estimate", "estimate", kind="text")
    def estimates_name(self) -> np.ndarray:
        sets = self.nearly_closed_sets
        ranks = [] if sets is None else sets.rank.tolist()
        of_sets = [f"{one} of set {k}" for one in ("leakage", "hours") for k in ranks]
        return np.array([*_OF_ALL[:-1], f"{_OF_ALL[-1]} {self.when}", *of_sets])

    @derived("estimate", "value")
    def estimates_value(self) -> Float[np.ndarray, "estimates"]:
        return self._of_all(self.spread.value)

    @derived("estimate", "error")
    def estimates_error(self) -> Float[np.ndarray, "estimates"]:
        return self._of_all(self.spread.error)

    @derived("estimate", "1 in 20 below")
    def estimates_low(self) -> Float[np.ndarray, "estimates"]:
        return self._of_all(self.spread.low)

    @derived("estimate", "1 in 20 above")
    def estimates_high(self) -> Float[np.ndarray, "estimates"]:
        return self._of_all(self.spread.high)

    @derived(_SQUARES, "moves that are known from the cell", kind="count")
    def count(self) -> Int[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self.counted.count.astype(np.int64), 0)

    @derived(_SQUARES, "error of the absorption time", "h", kind="time", padding=_LAND)
    def absorption_time_error(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.error, 1))

    @derived(
        _SQUARES,
        "how often the cell is in a persistent group, of drifters that are drawn anew",
        "1",
        kind="share",
        padding=_LAND,
    )
    def persistent_share(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.mean, 0))

    @derived(
        _SQUARES,
        "share of drifters there then that were released in all cells alike",
        "1",
        kind="share",
        padding=_LAND,
    )
    def distribution(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.value, 2))

    @derived(_SQUARES, "error of the distribution", "1", kind="share", padding=_LAND)
    def distribution_error(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.error, 2))

    def _of_all(self, answers: np.ndarray) -> Float[np.ndarray, "estimates"]:
        return answers[: -_OF_CELLS * self.cells]

    def _of_cells(self, answers: np.ndarray, place: int) -> Float[np.ndarray, "cells"]:
        return answers[-_OF_CELLS * self.cells :].reshape(_OF_CELLS, -1)[place]


def _answers(
    chain: Chain, lag: float, after: float | int | None, sets: ClosedSets | None
) -> Float[np.ndarray, "answers"]:
    """What is asked of each chain: numbers of the whole, and then three of every cell."""
    groups = persistent_groups(chain)
    persistent = np.asarray(groups.group) >= 0
    hours = np.asarray(absorption_times(chain, groups, throw=False).value) * lag / 3600
    if after is None:
        later = np.asarray(limiting_distribution(chain, groups, throw=False).value)
    else:
        later = push_on_host(chain, np.full(chain.cells, 1 / chain.cells), steps_in(after, lag))
    median = np.median(hours[~persistent]) if not persistent.all() else 0.0
    whole = [groups.count, persistent.sum(), median, max(0.0, round(1 - later.sum(), 12))]
    of_sets = () if sets is None else _leakage(chain, sets, lag)
    return np.concatenate([whole, *of_sets, persistent, hours, later.clip(0)])


def _leakage(
    chain: Chain, sets: ClosedSets, lag: float
) -> tuple[Float[np.ndarray, "sets"], Float[np.ndarray, "sets"]]:
    """The share that leaves each of the sets of all drifters, by another chain, and the hours."""
    (water,), (found,) = sets.waters, sets.layers
    area = water.sides.prod(axis=0)
    inside = found.begin == np.arange(found.count)[:, None]
    begin = inside * area
    begin /= begin.sum(axis=1, keepdims=True)
    later = (push_on_host(chain, one, found.steps) for one in begin)
    stays = np.array([one[here].sum() for one, here in zip(later, inside, strict=True)])
    again = dataclasses.replace(found, leakage=(1 - stays).clip(0))
    return again.leakage, again.time * (lag / 3600)
