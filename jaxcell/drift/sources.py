"""The sources of drifters that are found at a place, by Bayes' theorem."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from ..base.process import stoppable
from .flow import Flow
from .released_drifters import (
    Area,
    Look,
    Release,
    chain_between,
    follow_drifters,
    likely,
    met_in,
    on_cells,
    tick_of,
)
from .water import Water, square


BATCH = 10_000
"""The number of drifters that are followed together."""
# The part of the sources, by the chain of cells, whose cells drifters are released in; the largest
# number of batches, and of batches without a find.
_PART, _BATCHES, _IN_VAIN = 0.9999, 500, 20


def find_sources(
    water: Water,
    flow: Flow,
    found: Area,
    points: Float[np.ndarray, "2 points"],
    end: float,
    times: Sequence[float],
    regions: Sequence[shapely.Geometry] | np.ndarray = (),
    *,
    seed: int = 0,
    say: Callable[..., None] = lambda *_: None,
    **halves: float,
) -> tuple[Release, Float[np.ndarray, "times cells"], int]:
    """Follow drifters to a place where they are found, and look back at where they were.

    Drifters are released uniformly by area in the water, and follow the current forward. Those at
    the place at the end are a sample of the sources, by Bayes' theorem with a uniform prior. They
    are not followed backward, because that is another problem where drifters gather or strand.
    Cells from which by the chain of cells 1 in 10,000 comes, or fewer, are left out.

    **Arguments:**

    - `water`, `flow`, `regions`, `seed`, `say`: as for [`release_drifters`][].
    - `found`: the place; and `points` in it, uniform by area, as many as drifters are to be found.
    - `end`: the time when they are found, in seconds as in `Flow.time`.
    - `times`: the times before that are kept, in seconds, ascending; the last is the release.
    - `halves`: the half-lives `afloat` and `stranded` of [`release_drifters`][].

    **Returns:** the drifters that were found, whose times run back from `end`; the same shares by
    the chain; and the number of released drifters.

    **Raises:** `ValueError` if no drifter is found.
    """
    area, count = water.sides.prod(axis=0), points.shape[1]
    after = [times[-1] - time for time in reversed([0.0, *times])]
    start = end - times[-1]
    say("mapping the sources on cells")
    by_chain = _by_chain(water, flow, points, [start + time for time in after], halves, area)
    cells = np.flatnonzero(likely(by_chain[-1], _PART))
    if not cells.size:
        raise ValueError("start: no drifter comes there from the water of the map in this time")
    random, looks, seen = np.random.default_rng(seed), [], 0
    with stoppable(lambda: seen):
        for batch in range(_BATCHES):
            origin = random.choice(cells, BATCH, p=area[cells] / area[cells].sum())
            begin = np.stack([water.column, water.row])[:, origin]
            begin = begin + random.uniform(-0.5, 0.5, begin.shape)
            going: dict[str, Any] = {"tick": tick_of(water, flow), "seed": seed + batch, **halves}
            seen_by = [*follow_drifters(water, flow, begin, start, after[1:], **going)]
            here = found(seen_by[-1].x, seen_by[-1].y) & (seen_by[-1].cell >= 0)
            looks.append(
                [Look(times[-1] - look.seconds, *(of[here] for of in look[1:])) for look in seen_by]
            )
            seen += int(here.sum())
            say("following drifters to the place", min(seen, count), count)
            if seen >= count:
                break
            if not seen and batch + 1 >= _IN_VAIN:
                raise ValueError(
                    f"start: none of {_IN_VAIN * BATCH:,} drifters comes there; take a larger "
                    "--radius, or fewer days"
                )
    joined = (
        Look(
            same[0].seconds,
            *(np.concatenate(of)[:count] for of in zip(*(look[1:] for look in same), strict=True)),
        )
        for same in zip(*(reversed(one) for one in looks), strict=True)
    )
    return met_in(water, joined, times, regions, False), by_chain, len(looks) * BATCH


def _by_chain(
    water: Water,
    flow: Flow,
    points: Float[np.ndarray, "2 points"],
    times: Sequence[float],
    halves: dict[str, float],
    area: Float[np.ndarray, "cells"],
) -> Float[np.ndarray, "times cells"]:
    """Compute the distribution at times before the find by a chain, the latest time first."""
    steps = itertools.pairwise(times)
    chains = [chain_between(water, flow, begin, end, halves) for begin, end in steps]
    cell = chains[0][1]
    # The share of each cell that is in the place, up to a factor.
    within = np.bincount(water.at(*square(*points))[0], minlength=water.cells).astype(float)
    later = [np.append(within, within[cell])]
    for chain, _ in reversed(chains):
        later.append(chain.to_scipy() @ later[-1])
    share = np.append(area / area.sum(), np.zeros(cell.size))
    shares = [share]
    for chain, _ in chains[:-1]:
        shares.append(chain.to_scipy().T @ shares[-1])
    both = zip(reversed(shares), later[1:], strict=True)
    joint = np.stack([on_cells(water, share * value, cell) for share, value in both])
    return joint / np.maximum(joint.sum(axis=1, keepdims=True), np.finfo(float).tiny)
