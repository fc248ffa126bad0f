"""Distributions of drifters that are carried step by step, on the host.

There a step takes no program of its own for each number of cells, slots and phases.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ..mapping import Chain, ChainSequence
from ..mapping.sequence import as_sequence


def pushed(
    chain: Chain | ChainSequence, share: Float[np.ndarray, "cells"], steps: int, start: int = 0
) -> Iterator[Float[np.ndarray, "cells"]]:
    """The distribution at a phase, and after each of so many steps; what it lacks is gone.

    Half of what is in the first of two cells goes on to the second:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> from jaxcell.drift.pushed import pushed
        >>> chain = mapping.Chain.from_scipy(np.array([[0.5, 0.5], [0.0, 1.0]]))
        >>> [one.tolist() for one in pushed(chain, np.array([1.0, 0.0]), 2)]
        [[1.0, 0.0], [0.5, 0.5], [0.25, 0.75]]
    """
    tide = as_sequence(chain)
    image, probability = np.asarray(tide.image), np.asarray(tide.probability)
    yield share
    for step in range(start, start + steps):
        phase = step % tide.phases
        moved = probability[phase] * share
        share = np.bincount(image[phase].ravel(), moved.ravel(), share.size)
        yield share


def push(
    chain: Chain | ChainSequence, share: Float[np.ndarray, "cells"], steps: int, start: int = 0
) -> Float[np.ndarray, "cells"]:
    """The last of [`pushed`][]."""
    *_, last = pushed(chain, share, steps, start)
    return last
