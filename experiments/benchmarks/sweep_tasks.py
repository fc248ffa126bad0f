"""Tasks of `bench_sweep_engine.py`, which its workers import."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr


def wait(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Wait for `seconds` if the member is one of the first `slow`."""
    if batch["number"].min() < fixed["slow"]:
        time.sleep(fixed["seconds"])
    return xr.Dataset({"waited": ("member", batch["number"])})


def random_maps(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Count the periodic groups of random maps of `cells` cells, and their longest transient."""
    import jax

    images = [
        np.random.default_rng([seed, number]).integers(fixed["cells"], size=fixed["cells"])
        for number in batch["number"].tolist()
    ]
    groups, longest = _summaries()(jax.numpy.asarray(np.array(images, np.int32)))
    return xr.Dataset(
        {
            "groups": ("member", np.asarray(groups), {"long_name": "number of periodic groups"}),
            "longest": ("member", np.asarray(longest), {"long_name": "longest transient"}),
        }
    )


_kept: list[Any] = []


def _summaries() -> Any:
    """Compile the kernel, once per process."""
    if not _kept:
        import jax

        from jaxcell.mapping import periodic_groups

        def summary(image: jax.Array) -> tuple[jax.Array, jax.Array]:
            groups = periodic_groups(image)
            return groups.group.max() + 1, groups.step.max()

        _kept.append(jax.jit(jax.vmap(summary)))
    return _kept[0]
