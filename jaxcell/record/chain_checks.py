"""Checks of the datasets of patrollers and drifters; see [`jaxcell.record.checks`][]."""

import numpy as np
import scipy.sparse
import xarray as xr

from .checks import PROBABILITY, Checks, error_of_sums


# Of a time, relative to it.
_TIME = 1e-6


def patrol_graph_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.patrol_graph_dataset`][].

    The rows of the chain sum to 1; the share of time stays as it is by a step; from one vertex to
    another it takes one step more than from where that step leads; and the mixture is one.
    """
    P, share = dataset["transition"].values, dataset["stationary"].values
    times = dataset["hitting_time"].values
    gap = 1 + P @ times - times
    np.fill_diagonal(gap, 0)
    found: dict[str, tuple[float | int, float | int]] = {
        "rows_sum_to_1": (error_of_sums(P), PROBABILITY),
        "stationary_sums_to_1": (error_of_sums(share), PROBABILITY),
        "stationarity_residual": (float(np.abs(share @ P - share).sum()), PROBABILITY),
        "hitting_time_residual": (float(np.abs(gap).max() / max(1.0, times.max())), _TIME),
        "commute_is_there_and_back": (
            float(np.abs(times + times.T - dataset["commute_time"].values).max()),
            _TIME * max(1.0, float(times.max())),
        ),
    }
    if "mixture" in dataset:
        found["mixture_sums_to_1"] = (error_of_sums(dataset["mixture"].values), PROBABILITY)
    return found


def drift_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.drift_dataset`][].

    No row of the chain sums to more than 1; nothing leaves a persistent group; the probabilities of
    where a drifter ends sum to 1, each that of a cell is the mean of those of its images, and so
    are, with one step more, the times. These last are told only: where drifters stay almost for
    ever no solve is good. So are probabilities of arriving beyond 0 to 1.
    """
    cell = dataset["cell"].values
    wet = cell >= 0
    number = cell[wet]
    cells = number.size
    entries = (dataset["from_cell"].values, dataset["to_cell"].values)
    P = scipy.sparse.csr_array((dataset["transition"].values, entries), shape=(cells, cells))

    def listed(name: str) -> np.ndarray:
        values = np.empty(cells, dataset[name].dtype)
        values[number] = dataset[name].values[wet]
        return values

    layer = np.empty(cells, np.int32)
    layer[number] = np.nonzero(wet)[0]
    group, total = listed("group"), np.asarray(P.sum(axis=1)).ravel()
    home = np.where(group >= 0, group * dataset.sizes["layer"] + layer, -1)
    here, there = entries
    out = (home[here] >= 0) & (home[here] != home[there])
    gone = (home >= 0) & (total < 1 - PROBABILITY)
    hours, step = listed("absorption_time"), dataset.attrs["step_seconds"] / 3600
    transient = group < 0
    with np.errstate(invalid="ignore"):
        late = np.abs(step + P @ hours - hours)[transient] / np.maximum(hours[transient], step)
    found: dict[str, tuple[float | int, float | int]] = {
        "rows_sum_to_more_than_1": (max(0.0, float(total.max() - 1)), PROBABILITY),
        "ways_out_of_persistent_groups": (int(out.sum() + gone.sum()), 0),
        "absorption_time_residual": (_finite_largest(late), np.inf),
    }
    if "probability" in dataset:
        leaving, ends = listed("leaving"), dataset["probability"].values
        chance = np.empty((len(number), ends.shape[1]))
        chance[number] = np.moveaxis(ends, 1, -1)[wet]
        told = np.isfinite(leaving) & (np.isfinite(chance).any(axis=1) | (leaving == 1))
        # A cell of another layer than the group's is in none of its rows.
        chance = np.where(told[:, None], np.nan_to_num(chance), 0)
        sums = np.append(np.abs(chance.sum(axis=1) + leaving - 1)[told], 0.0)
        mean = np.abs(P @ chance - chance)[told & transient]
        found["ends_sum_to_1"] = (float(sums.max()), PROBABILITY)
        found["ends_residual"] = (float(mean.max(initial=0.0)), PROBABILITY)
    if "arrival_probability" in dataset:
        arrive = listed("arrival_probability")
        beyond = max(0.0, float(-arrive.min()), float(arrive.max() - 1))
        found["arrival_beyond_0_to_1"] = (beyond, PROBABILITY)
    return found


def _finite_largest(values: np.ndarray) -> float:
    return float(np.max(values[np.isfinite(values)], initial=0.0))
