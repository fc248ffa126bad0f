"""Checks of the datasets of patrollers and drifters; see [`jaxcell.record.checks`][]."""

import numpy as np
import scipy.sparse
import xarray as xr

from .checks import PROBABILITY, Checks, error_of_sums


def patrol_map_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.patrol_map_dataset`][].

    The rows of each robot's chain, the weights of its edges, and the mixture sum to 1;
    probabilities of capture are from 0 to 1 and grow with the attack time; the exact ones are sums
    of the law; and how many standard deviations the simulated ones are from them is told.
    """
    times, capture = dataset["attack_time"].values, dataset["capture"].values
    exact, law = dataset["exact"].values, dataset["law"].values
    later = np.diff(capture[np.argsort(times, kind="stable")], axis=0)
    runs = dataset.sizes["run"]
    spread = np.sqrt(np.maximum(exact * (1 - exact), 1 / runs) / runs)
    simulated = np.abs(dataset["simulated"].values - exact) / spread
    found: dict[str, tuple[float | int, float | int]] = {
        "rows_sum_to_1": (
            error_of_sums(np.moveaxis(dataset["probability"].values, 1, -1)),
            PROBABILITY,
        ),
        "capture_beyond_0_to_1": (
            float(max(-capture.min(), capture.max() - 1, 0.0)),
            PROBABILITY,
        ),
        "capture_falls_with_time": (float(np.max(-later, initial=0.0)), PROBABILITY),
        "exact_is_of_law": (float(np.abs(np.cumsum(law)[times] - exact).max()), PROBABILITY),
        "law_beyond_1": (float(max(law.sum() - 1, 0.0)), PROBABILITY),
        "simulated_standard_deviations": (float(simulated.max()), np.inf),
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
