"""Time periodic groups of maps that are arrays, beside the components of scipy."""

import math
import sys
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.sparse
from rows import Row, rows_of
from timing import table, take_turns

from jaxcell import dynamics
from jaxcell.dynamics import systems
from jaxcell.mapping import periodic_groups
from jaxcell.space import Box


def any_map(bounced: np.ndarray, repeats: int) -> list[Row]:
    """Time a bounce map, and dissipative, random and one-to-one maps of the same size."""
    size, draw = bounced.size, np.random.default_rng(0)
    images = {
        "a bounce map": bounced,
        "a dissipative map": dissipative(size),
        "a random map": draw.integers(0, size, size).astype(np.int32),
        "a permutation": draw.permutation(size).astype(np.int32),
    }
    rows = []
    for name, image in images.items():
        rows += of_image(name, image, repeats)
    return rows


def dissipative(size: int) -> np.ndarray:
    """Make the image of Henon's map with about `size` cells, including two sinks."""
    side = math.isqrt(size)
    box = Box([-2, -2], [2, 2], cells=[side, side])
    image = dynamics.images(systems.henon.map, box, dict(systems.henon.params))
    return np.append(image, np.array([box.outside, box.nowhere], np.int32))


def of_image(name: str, image: np.ndarray, repeats: int) -> list[Row]:
    """Time the groups and components of one map."""
    size = image.size
    graph = scipy.sparse.csr_array(
        (np.ones(size, np.int8), image, np.arange(size + 1, dtype=np.int32)), shape=(size, size)
    )
    components = scipy.sparse.csgraph.connected_components
    given = jnp.asarray(image)
    # Strong components are the groups of periodic cells, and weak components the basins.
    calls: dict[str, Callable[[], Any]] = {
        "periodic_groups(image)": lambda: periodic_groups(given),
        "scipy connected_components, strong": lambda: components(graph, connection="strong"),
        "scipy connected_components, weak": lambda: components(graph, connection="weak"),
    }

    def pairs(one: np.ndarray, other: np.ndarray) -> int:
        return np.unique(one.astype(np.int64) * size + other).size

    def check(results: dict[str, Any]) -> None:
        groups, (_, strong), (basins, weak) = results.values()
        group, periodic = np.asarray(groups.group), np.asarray(groups.periodic)
        counts = {pairs(group, weak), pairs(group[periodic], strong[periodic]), basins}
        if counts != {int(groups.count)}:
            sys.exit("scipy and periodic_groups disagree")

    timings = take_turns(calls, repeats, check)
    table(f"Any map: {name}, {size:,} cells, image given", timings)
    return rows_of("groups", f"groups of {name}, image given", f"{size:,} cells", timings)
