import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...base.formatting import counted, in_time, percent
from ...base.quantities import derived, from_part
from ...mapping import Chain, persistent_groups
from ...mapping.sequence import push_on_host
from ...markov import absorption_times, limiting_distribution
from ..closed_sets import ClosedSets
from ..flow import steps_in
from ..long_term import long_term_behaviour
from ..results.layer_ends import LayerEnds
from ..results.layered_result import LayeredResult
from .moves import CountedMoves, Spread, bootstrap
from .trajectories import Trajectories


_PADDING = "NaN: too few drifters were there"
_share = functools.partial(derived, "layer y x", units="1", kind="share", padding=_PADDING)
# The answers from each resampled chain about the whole map, and the number of answers per cell.
_OF_ALL = "persistent groups", "cells of persistent groups", "median hours to the end", "share left"
_OF_CELLS = 3


def _of_all(name: str, meaning: str) -> Any:
    """Build a property, described by `meaning`: `name` in `spread`, without the values per cell."""
    return derived("estimate", meaning)(
        lambda drift: getattr(drift.spread, name)[: -_OF_CELLS * drift.cells]
    )


@dataclasses.dataclass(frozen=True, eq=False)
class ObservedDrift(LayeredResult):
    """The long-term behaviour of observed drifters, from the chain of their moves.

    A hundred drifters begin in one cell; 60 leave it in a day, so the mean stay is 40 ± 4 hours:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> lon = np.stack([np.full(100, 0.5), 0.5 + (np.arange(100) < 60)], axis=1).ravel()
        >>> time, number = np.tile([0.0, 86400.0], 100), np.arange(100).repeat(2)
        >>> seen = drift.Trajectories.of(lon, 0 * lon + 0.5, time, number)
        >>> moves = drift.count_moves(seen, drift.boxes(seen, 1.0), 86400.0)
        >>> observed = drift.ObservedDrift.of(seen, moves, samples=20)
        >>> error = float(np.nanmax(observed.absorption_time_error))
        >>> observed.cells, round(observed.median_hours), round(error)
        (1, 40, 4)
    """

    title: ClassVar[str] = "Long-term behaviour of drifters that were observed"
    tables: ClassVar[Mapping[str, str]] = {"estimate": "estimates"}
    brief: ClassVar[tuple[str, ...]] = (
        *("persistent_groups", "mean_leaving", "median_hours", "drifters", "observations"),
        *("drogued_share", "moves", "cells", "step", "estimate"),
    )

    seen: Trajectories
    "The trajectories."
    counted: CountedMoves
    "The moves between cells."
    spread: Spread
    "The estimates from the chain, with sampling errors from a bootstrap over drifters."
    nearly_closed_sets: ClosedSets | None = None
    "Sets of cells that few drifters leave."
    after: float | int | None = None
    "The seconds from a uniform release to the `distribution`; `None` for the long run."

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
        """Compute the long-term behaviour from the chain of moves.

        **Arguments:**

        - `seen`, `moves`: the trajectories, and their moves from [`jaxcell.drift.count_moves`][].
        - `after`: the time in seconds after a uniform release of drifters at which to estimate
            their distribution; by default it is estimated for the long run.
        - `sets`: the number of nearly closed sets to find.
        - `samples`, `seed`: as for [`jaxcell.drift.bootstrap`][].
        - `say`: a function that is called with the name of each stage of the computation.
        """
        chain, water, lag = moves.chain, moves.water, float(moves.lag)
        closed = None if sets is None else ClosedSets.of([water], [chain], lag, sets)
        done = itertools.count()

        def answers(chain: Chain) -> Float[np.ndarray, "answers"]:
            say("resampling drifters", next(done), samples + 1)
            return _answers(chain, lag, after, closed)

        spread = bootstrap(moves, answers, samples, seed)
        layer = LayerEnds(water, long_term_behaviour(chain, lag))
        return cls((layer,), seen, moves, spread, closed, after)

    @property
    def answer(self) -> tuple[str, ...]:
        count, held, median, left = self.spread.value[: len(_OF_ALL)].tolist()
        low, high = (percent(of[len(_OF_ALL) - 1]) for of in (self.spread.low, self.spread.high))
        gone = f"{percent(left)} of the drifters have left the map"
        groups = counted(int(count), "persistent group")
        kept = f"{held:,.0f} of {self.cells:,} cells are in {groups}"
        rest = f"; the median time from the others to a group or off the map is {in_time(median)}"
        return (
            f"{self.when[0].upper()}{self.when[1:]} {gone} (90 % of estimates: {low} to {high}).",
            f"{kept}{rest if held < self.cells else ''}.",
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = self.layers[0].remarks
        if self.after is None and not self._of_cells(self.spread.value, 2).any():
            earlier = "--after chooses an earlier time."
            remarks += (f"In the long run all drifters have left the map; {earlier}",)
        if (drogued := self.drogued_share) is not None and drogued not in (0.0, 1.0):
            remarks += (
                f"{1 - drogued:.0%} of the observations are of drifters that had lost "
                "their drogue, which go with the wind too; --drogue kept leaves them out.",
            )
        return remarks

    @property
    def when(self) -> str:
        """The time of the `distribution`, in words."""
        return "in the long run" if self.after is None else f"after {self.after / 86400:g} days"

    drifters = from_part("seen.drifters", "", "drifters that were observed", kind="count")
    observations = from_part("seen.lon.size", "", "observations", kind="count")

    @derived("", "observations of drifters with their drogue", kind="share")
    def drogued_share(self) -> float | None:
        return None if self.seen.drogued is None else float(self.seen.drogued.mean())

    moves = from_part("counted.begin.size", "", "moves between cells", kind="count")
    source = from_part("seen.source", "", "trajectories of")

    @derived("estimate", "estimate", kind="text")
    def estimates_name(self) -> np.ndarray:
        sets = self.nearly_closed_sets
        ranks = [] if sets is None else sets.rank.tolist()
        of_sets = [f"leakage of set {k}" for k in ranks]
        return np.array([*_OF_ALL[:-1], f"{_OF_ALL[-1]} {self.when}", *of_sets])

    estimates_value = _of_all("value", "value")
    estimates_error = _of_all("error", "error")
    estimates_low = _of_all("low", "1 in 20 below")
    estimates_high = _of_all("high", "1 in 20 above")

    @derived("layer y x", "moves that are known from the cell", kind="count")
    def count(self) -> Int[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self.counted.count.astype(np.int64), 0)

    @derived("layer y x", "error of the absorption time", "h", kind="time", padding=_PADDING)
    def absorption_time_error(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.error, 1))

    @_share("share of the draws in which the cell is in a persistent group")
    def persistent_share(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.mean, 0))

    @_share("share of drifters in the cell at that time, released uniformly")
    def distribution(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.value, 2))

    @_share("error of the distribution")
    def distribution_error(self) -> Float[np.ndarray, "layers rows columns"]:
        return self._on_squares(lambda _: self._of_cells(self.spread.error, 2))

    def _of_cells(self, answers: np.ndarray, place: int) -> Float[np.ndarray, "cells"]:
        return answers[-_OF_CELLS * self.cells :].reshape(_OF_CELLS, -1)[place]


def _answers(
    chain: Chain, lag: float, after: float | int | None, sets: ClosedSets | None
) -> Float[np.ndarray, "answers"]:
    """Compute the estimates from a chain whose steps last `lag` seconds, as one array.

    The array has what `_OF_ALL` names; the leakages of the sets; and for each cell whether it is
    persistent, its absorption time, and its share of the drifters after `after`."""
    groups = persistent_groups(chain)
    persistent = np.asarray(groups.group) >= 0
    hours = np.asarray(absorption_times(chain, groups, throw=False).value) * lag / 3600
    if after is None:
        later = np.asarray(limiting_distribution(chain, groups, throw=False).value)
    else:
        later = push_on_host(chain, np.full(chain.cells, 1 / chain.cells), steps_in(after, lag))
    median = np.median(hours[~persistent]) if not persistent.all() else 0.0
    whole = [groups.count, persistent.sum(), median, max(0.0, round(1 - later.sum(), 12))]
    of_sets = np.zeros(0) if sets is None else _leakage(chain, sets)
    return np.concatenate([whole, of_sets, persistent, hours, later.clip(0)])


def _leakage(chain: Chain, sets: ClosedSets) -> Float[np.ndarray, "sets"]:
    """Compute the leakage of nearly closed sets from a chain of resampled drifters."""
    (water,), (closed,) = sets.waters, sets.layers
    inside = closed.begin == np.arange(closed.count)[:, None]
    begin = inside * water.sides.prod(axis=0)
    begin /= begin.sum(axis=1, keepdims=True)
    later = [push_on_host(chain, share, closed.steps) for share in begin]
    return np.array([1 - after[at].sum() for after, at in zip(later, inside, strict=True)]).clip(0)
