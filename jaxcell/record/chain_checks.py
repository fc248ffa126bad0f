"""Checks of the datasets of patrollers; see [`jaxcell.record.checks`][]."""

import numpy as np
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
