import numpy as np
from jaxtyping import Int


def copies(
    count: Int[np.ndarray, "originals"],
) -> tuple[Int[np.ndarray, "copies"], Int[np.ndarray, "copies"]]:
    """Repeat each index `k` of the array `count` exactly `count[k]` times.

    Returns the index of each copy, and its number among the copies of the same index.
    """
    index = np.repeat(np.arange(count.size), count)
    return index, np.arange(index.size) - np.repeat(np.cumsum(count) - count, count)
