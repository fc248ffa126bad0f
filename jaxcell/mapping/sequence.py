import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base import memory
from ..base.indices import as_array
from ..base.shown import Shown
from ..base.wide import traced
from .generalized import BYTES_PER_SLOT, Chain, ChainLike, check_arrays, number_per_cell


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ChainSequence(Shown):
    """A periodic sequence of chains over the same cells, one per step, as in a tide or a year.

    The *phase* is the number of the chain that acts next. The product of all chains, the *period
    map*, is not sparse, so it is never computed: distributions are pushed, and values are pulled,
    through one chain after another. Other analyses of chains apply to the *unrolled* chain, whose
    states are the cells at phase 0, then the cells at phase 1, and so on. It has as many edges as
    all chains together, and its strong components at phase 0 are those of the period map.

    The first chain exchanges two cells. In the second chain, cell 0 stays, and cell 1 leaves the
    space with probability 1/2. So no set of cells is closed:

        >>> import numpy as np
        >>> from jaxcell import mapping
        >>> swap = mapping.Chain.from_scipy(np.array([[0.0, 1.0], [1.0, 0.0]]))
        >>> stay = mapping.Chain.from_scipy(np.array([[1.0, 0.0], [0.0, 0.5]]))
        >>> tide = mapping.ChainSequence.of([swap, stay])
        >>> tide.push(np.array([1.0, 0.0]), 2).tolist(), tide.pull(np.ones(2), 2).tolist()
        ([0.0, 0.5], [0.5, 1.0])
        >>> mapping.persistent_groups(tide).group.tolist()
        [-1, -1]
    """

    image: Int[Array, "phases branches cells"]
    probability: Float[Array, "phases branches cells"]

    def __post_init__(self) -> None:
        for name in ("image", "probability"):
            object.__setattr__(self, name, as_array(getattr(self, name), name))
        check_arrays(self.image, self.probability, ("phases", "branches", "cells"))

    @classmethod
    def of(cls, chains: Sequence[ChainLike]) -> "ChainSequence":
        """Create a sequence from chains, one for each phase."""
        sizes = {chain.cells for chain in chains}
        if len(sizes) != 1:
            raise ValueError(
                f"chains: expected one or more over the same cells, got sizes {sorted(sizes)}"
            )
        branches = max(chain.image.shape[0] for chain in chains)
        cells = sizes.pop()
        memory.check(
            len(chains) * branches * cells * BYTES_PER_SLOT,
            f"a sequence of {len(chains)} chains of {cells} cells with {branches} images each",
            "use fewer phases, or chains whose cells have fewer images",
        )
        image = np.tile(np.arange(cells, dtype=np.int32), (len(chains), branches, 1))
        probability = np.zeros(image.shape)
        for phase, chain in enumerate(chains):
            used = chain.image.shape[0]
            image[phase, :used], probability[phase, :used] = chain.image, chain.probability
        return cls(jax.device_put(image), jax.device_put(probability))

    @property
    def phases(self) -> int:
        """Number of chains."""
        return self.image.shape[0]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.image.shape[2]

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of an array with an entry per phase and cell."""
        return self.phases, self.cells

    def at(self, phase: Int[Array, ""] | int) -> Chain:
        """Return the chain that acts at a phase, which is taken modulo the number of chains."""
        if not np.issubdtype(jnp.result_type(as_array(phase, "phase")), np.integer):
            raise ValueError(f"phase: expected a whole number, got {phase!r}")
        fields = (self.image[phase % self.phases], self.probability[phase % self.phases])
        return Chain.tree_unflatten(None, fields)

    def push(
        self, distribution: npt.ArrayLike, steps: Int[Array, ""] | int
    ) -> Float[Array, "cells"]:
        """Compute the distribution `steps` steps after phase 0; its missing mass is in the sink."""
        check_steps(steps)
        distribution = number_per_cell(distribution, self.cells, "distribution")
        return _applied(self, distribution, steps, "push")

    def pushed(
        self, distribution: Float[np.ndarray, "cells"], steps: int
    ) -> Iterator[Float[np.ndarray, "cells"]]:
        """Yield the distribution at phase 0, and after each of the next `steps` steps.

        It is computed on the host, because JAX would compile for each number of cells and phases.
        """
        check_steps(steps)
        distribution = number_per_cell(distribution, self.cells, "distribution")
        image, probability = np.asarray(self.image), np.asarray(self.probability)
        yield distribution
        for step in range(steps):
            phase = step % self.phases
            moved = probability[phase] * distribution
            distribution = np.bincount(image[phase].ravel(), moved.ravel(), self.cells)
            yield distribution

    def pull(self, value: npt.ArrayLike, steps: Int[Array, ""] | int) -> Float[Array, "cells"]:
        """Compute the expected value after `steps` steps from cells at phase 0; the sink has 0."""
        check_steps(steps)
        return _applied(self, number_per_cell(value, self.cells, "value"), steps, "pull")

    @functools.cached_property
    def unrolled(self) -> Chain:
        """The chain whose state `k * cells + i` is cell `i` at phase `k`.

        Steps lead from each phase to the next, and from the last phase to phase 0.
        """
        later = (np.arange(self.phases, dtype=np.int32) + 1) % self.phases * self.cells
        image = np.asarray(self.image) + later[:, None, None]
        both = (np.moveaxis(a, 1, 0) for a in (image, np.asarray(self.probability)))
        fields = tuple(jax.device_put(a.reshape(a.shape[0], -1)) for a in both)
        return Chain.tree_unflatten(None, fields)

    def to_scipy(self) -> scipy.sparse.csr_array:
        """Return the transition matrix of the unrolled chain."""
        return self.unrolled.to_scipy()


def _applied(sequence: ChainSequence, values: Any, steps: Any, way: str) -> Any:
    """Push or pull values through the chains of the steps, one after the other."""
    # If JAX traces the values but not the steps, the length of the loop stays static, as reverse
    # derivatives require. Otherwise one program serves all numbers of steps.
    return (_loop if traced(sequence, values) else _compiled)(sequence, values, steps, way)


def _loop(sequence: ChainSequence, values: Any, steps: Any, way: str) -> Any:
    # Derivatives keep the values before each step, but not the arrays of each chain.
    @jax.checkpoint
    def step(n, values):  # type: ignore[no-untyped-def]
        chain = sequence.at(n if way == "push" else last - n)
        return getattr(chain, way)(values)

    last = steps - 1
    return jax.lax.fori_loop(0, steps, step, values)


_compiled = jax.jit(_loop, static_argnames="way")


def check_steps(steps: Int[Array, ""] | int) -> None:
    """Raise `ValueError` unless a number of steps is whole and not negative."""
    if not np.issubdtype(jnp.result_type(as_array(steps, "steps")), np.integer) or np.ndim(steps):
        raise ValueError(f"steps: expected a whole number, got {steps!r}")
    if not isinstance(steps, jax.core.Tracer) and steps < 0:
        raise ValueError(f"steps: expected 0 or more, got {steps}")


def as_sequence(chain: Chain | ChainSequence) -> ChainSequence:
    """Return a sequence of chains; a single chain becomes a sequence of one."""
    return chain if isinstance(chain, ChainSequence) else ChainSequence.of([chain])


def push_on_host(
    chain: Chain | ChainSequence, distribution: Float[np.ndarray, "cells"], steps: int
) -> Float[np.ndarray, "cells"]:
    """Compute the distribution `steps` steps after phase 0, on the host."""
    for later in as_sequence(chain).pushed(distribution, steps):
        distribution = later
    return distribution
