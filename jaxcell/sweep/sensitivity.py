"""Sobol indices: the shares of the variance of a variable that are due to each parameter."""

import dataclasses
import itertools
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.shown import Shown
from .design import RANDOM_DIMENSION
from .results import open_sweep
from .storage.damage import reading
from .storage.store import SweepStore


if TYPE_CHECKING:
    import xarray as xr


_RESAMPLES = 200
_CONFIDENCE = 0.95


@dataclasses.dataclass(frozen=True)
class SobolIndex(Shown):
    """The share of the variance of a variable that is due to one parameter."""

    variable: str
    parameter: str
    at: Mapping[str, Any]
    "The values of the grid parameters at which the index is estimated; empty without a grid."
    first_order: float
    "The share of the variance that the parameter alone causes."
    first_order_interval: tuple[float, float]
    "95 % confidence interval of `first_order`, from a bootstrap over the samples."
    total: float
    "The share of the variance that the parameter causes alone, or together with other parameters."
    total_interval: tuple[float, float]
    "95 % confidence interval of `total`."


def sobol_indices(out: str | os.PathLike[str]) -> tuple[SobolIndex, ...]:
    """Estimate the first-order and total Sobol indices of each variable of a sweep.

    The estimators are those of Saltelli et al. (2010), as in `scipy.stats.sobol_indices`. The
    indices of a constant variable are 0.

    **Arguments:** the folder of a complete sweep with the design `saltelli`. **Returns:** a
    [`SobolIndex`][] for each variable, each combination of grid parameters, and each parameter of
    the table `[random]`. Variables without one finite number per member are left out.

    The periodic groups of one map at three angles:

        >>> from jaxcell import examples, sweep
        >>> lines = (
        ...     'task = "groups"', "[fixed]", 'map = "@lab_a"', "[random]", "samples = 2",
        ...     'design = "saltelli"', "bounce = {choice = [45, 90, 135]}",
        ... )
        >>> out = examples.folder()
        >>> _ = (out / "angles.toml").write_text("\\n".join(lines))
        >>> _ = sweep.run_sweep(sweep.Spec.load(out / "angles.toml"), out)
        >>> indices = sweep.sobol_indices(out)
        >>> indices[0].variable, indices[0].parameter
        ('count', 'bounce')
    """
    with SweepStore(Path(out)) as store:
        spec = store.spec
    if not spec.has_indices:
        raise ValueError(
            f'{out}: Sobol indices need the samples of design = "saltelli", in the table [random]'
        )
    names = [one.name for one in spec.parameters if one.dimension == RANDOM_DIMENSION]
    with open_sweep(out) as dataset, reading(Path(out)):
        if (missing := int((dataset["status"] != 1).sum())) > 0:
            raise ValueError(
                f"{out}: Sobol indices need all members; {missing:,} of {spec.members:,} are not "
                "done"
            )
        variables = [
            values.load()
            for name, values in dataset.data_vars.items()
            if name != "status" and set(values.dims) == set(spec.dimensions)
        ]
    return tuple(index for values in variables for index in _of_variable(values, names, spec.seed))


def _of_variable(values: "xr.DataArray", names: list[str], seed: int) -> Iterator[SobolIndex]:
    grid = [str(name) for name in values.dims if name != RANDOM_DIMENSION]
    for places in itertools.product(*(range(values.sizes[name]) for name in grid)):
        subset = values.isel(dict(zip(grid, places, strict=True)))
        rows = subset.values.astype(float).reshape(-1, len(names) + 2)
        if not np.isfinite(rows).all():
            continue
        estimates, low, high = _estimated(rows, seed)
        at = {name: subset[name].item() for name in grid}
        for i, name in enumerate(names):
            first, total = estimates[:, i].tolist()
            of_first, of_total = zip(low[:, i].tolist(), high[:, i].tolist(), strict=True)
            yield SobolIndex(str(values.name), name, at, first, of_first, total, of_total)


def _estimated(rows: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate first-order and total indices, and the ends of their confidence intervals.

    In Saltelli's design, A and B are independent samples. Row i has the outputs at point i of A, at
    point i of B, and, for each parameter in turn, at point i of A with this parameter from B. Each
    of the returned arrays has the shape `(2, parameters)`.
    """
    from scipy import stats

    def indices(chosen: np.ndarray) -> np.ndarray:
        a, b, *mixed = rows[chosen].T
        # Two equal outputs, because SciPy does not accept one output of one parameter.
        values = {"f_A": [a] * 2, "f_B": [b] * 2, "f_AB": [[one] * 2 for one in mixed]}
        arrays = {name: np.array(some) for name, some in values.items()}
        estimates = stats.sobol_indices(func=arrays, n=len(chosen))
        return np.stack(
            [one.reshape(2, -1)[0] for one in (estimates.first_order, estimates.total_order)]
        )

    whole = np.arange(len(rows))
    if len(rows) < 2:
        estimates = indices(whole)
        return estimates, estimates, estimates
    interval = stats.bootstrap(
        [whole],
        indices,
        n_resamples=_RESAMPLES,
        confidence_level=_CONFIDENCE,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return indices(whole), interval.low, interval.high
