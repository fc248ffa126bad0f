import numpy as np
from jaxtyping import Int

from ..base.indices import check_indices
from ..mapping.generalized import ChainLike
from ..mapping.sequence import check_steps


def sample_walks(
    chain: ChainLike, starts: Int[np.ndarray, "walks"], steps: int, random: np.random.Generator
) -> Int[np.ndarray, "times walks"]:
    """Draw independent walks along a chain that never leaves the space.

    It runs on the host, because the random numbers come from a generator of NumPy.

    **Arguments:** a chain, a first cell for each walk, the number of steps, and a generator of
    random numbers. **Returns:** the cell of each walk at each time, the starts first.

    **Raises:** `ValueError` if a start does not exist, or if the chain may leave the space.

    A walk around a ring of three cells:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> ring = mapping.Chain(np.array([[1, 2, 0]]), np.ones((1, 3)))
        >>> markov.sample_walks(ring, np.array([1]), 3, np.random.default_rng(0)).ravel().tolist()
        [1, 2, 0, 1]
    """
    image, up_to = np.asarray(chain.image), np.cumsum(np.asarray(chain.probability), axis=0)
    check_steps(steps)
    here = np.asarray(check_indices(starts, chain.cells, "starts"), np.int32)
    if chain.can_leave.any():
        cell = int(np.argmax(chain.can_leave))
        raise ValueError(f"chain: expected one that never leaves the space, as cell {cell} may")
    walks = [here]
    for drawn in random.random((steps, here.size)):
        chances = up_to[:, here]
        # Sums of probabilities are 1 only to rounding.
        branch = (chances <= drawn * chances[-1]).sum(axis=0)
        here = image[branch, here]
        walks.append(here)
    return np.stack(walks)
