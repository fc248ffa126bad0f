"""Mean times to attractors."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .batches import padded, slices, totals
from .maps import Flow, Map
from .orbits import NONE, attractor_owners, orbit_ends


def means_over_cells(basins: Any) -> dict[str, Any]:
    """Average `step` and `time` over the cells of each basin; return fields of `Basins`."""
    count = basins.attractors
    cells = np.maximum(1, totals(basins.basin, count))
    steps = totals(basins.basin, count, basins.step) / cells
    time = None if basins.duration is None else basins.duration * steps
    if basins.time is not None:
        time = totals(basins.basin, count, basins.time) / cells
    return {"mean_steps": steps, "mean_steps_error": np.zeros(count), "mean_time": time}


def mean_arrivals(map: Map, basins: Any) -> dict[str, Any]:
    """Average the times to attractors, from cells or from the orbits of random starts.

    Cells lead to groups of cells. If these are not exactly the attractors, cells end too early, and
    orbits are followed instead. A mean is NaN if it is not known whether an orbit arrives.
    """
    if _groups_are_attractors(basins):
        return means_over_cells(basins)
    box, count, starts = basins.box, basins.attractors, basins.starts
    owner = attractor_owners(box, basins.attractor_cells)
    ends, steps = orbit_ends(map, box, basins.params, owner, starts, follow=basins.follow)
    come = np.where(ends >= 0, steps, 0)
    if hasattr(map, "timed"):
        params = jax.tree.map(jnp.asarray, basins.params)
        time = padded(lambda *rows: _lasted(map, box, params, *rows), (starts, come))
    elif isinstance(map, Flow):
        time = map.dt * map.usual * come
    else:
        time = None if basins.duration is None else basins.duration * come
    own = [ends == k for k in range(count)]
    unknown = np.isin(np.arange(count), basins.ends[ends == NONE])
    number = np.where(unknown, 0, np.array([each.sum() for each in own], int))

    def mean(values: np.ndarray) -> Float[np.ndarray, "attractors"]:
        known = zip(own, number, strict=True)
        return np.array([values[each].mean() if n > 0 else np.nan for each, n in known])

    known = zip(own, number, strict=True)
    error = [come[each].std(ddof=1) / n**0.5 if n > 1 else np.nan for each, n in known]
    return {
        "mean_steps": mean(come),
        "mean_steps_error": np.array(error),
        "mean_time": None if time is None else mean(time),
    }


def _groups_are_attractors(basins: Any) -> bool:
    """Check that the groups that lead to each attractor have exactly its cells."""
    step, basin = basins.step, basins.basin
    on = sum(
        np.count_nonzero((step[part] == 0) & (basin[part] >= 0)) for part in slices(basins.box.size)
    )
    each = (
        ((step[cells] == 0) & (basin[cells] == k)).all()
        for k, cells in enumerate(basins.attractor_cells)
    )
    return bool(on == basins.cells_on.sum() and all(each))


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _lasted(map: Any, box: Any, params: Any, start: Any, steps: Any) -> Any:
    """Sum the durations of the first `steps` mappings of each start."""

    def lasted(x, steps):  # type: ignore[no-untyped-def]
        def step(_, state):  # type: ignore[no-untyped-def]
            x, time = state
            x, more = map.timed(x, params)
            return box.wrapped(x), time + more

        return jax.lax.fori_loop(0, steps, step, (x, jnp.zeros((), x.dtype)))[1]

    return jax.vmap(lasted)(start, steps)
