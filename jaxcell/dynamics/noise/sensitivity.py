"""Derivatives of the mean time that a noisy system stays, with all digits if it is long."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from ...markov.transient import Transient
from ..maps import Flow, with_params
from .chains import traced_rows
from .deviations import listed
from .diffusion import diffusion_to
from .ends import Ends
from .law import Law, visits_of


# Number of steps above which solutions that are not found by elimination lose digits.
LONG = 1e6


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """The contributions of the steps of a chain that stops at its ends to its mean time.

    A step to cell `j` instead of cell `i` changes the time by the difference of the mean times from
    these cells. Where both are long, it would have no digits. So each is the time to a hub, or to
    an end before it, plus the time from the hub unless there is an end before: the differences are
    those of short times, and of small probabilities of an end.
    """

    ends: Ends
    visits: Float[np.ndarray, "cells"]
    later: Float[np.ndarray, "2 cells"]
    "Times to the hub, and minus the probabilities of an end before it, relative to the mean time."

    @classmethod
    def of(
        cls,
        ends: Ends,
        matrix: csr_array,
        part: Transient,
        visited: Float[np.ndarray, "part"],
        weight: Float[np.ndarray, "part"],
        times: Float[np.ndarray, "part"],
        *,
        settled: bool,
        continuous: bool,
    ) -> "Sensitivity":
        """Solve a chain, given the visits and the mean times of cells of its transient part.

        A `settled` start, the quasi-stationary distribution, changes with the chain. Then the right
        eigenvector of the slowest mode replaces the times.
        """
        cells, mean = part.cells, float(weight @ times)
        visits, later = np.zeros(ends.cells), np.zeros((2, ends.cells))
        visits[cells] = visited
        hub = int(visited.argmax())
        gain, length = np.ones(cells.size), float(times[hub])
        scale = length / mean
        if settled:
            longest = float(times.max())
            about = visits_of(part, longest, continuous, ahead=True), longest, continuous
            mode = Law.of(gain / cells.size, *about)[0].quasi
            gain, scale, length = mode / mode[hub], float(mode[hub] / (weight @ mode)), mean
        others = np.delete(np.arange(cells.size), hub)
        rest = Transient.of(matrix, np.isin(np.arange(ends.cells), cells[others]))
        out = matrix[rest.cells][:, ends.box.size :] @ np.ones(len(ends.names))
        columns = np.column_stack([gain[others] / length, out])
        later[:, rest.cells] = rest.expect(columns, by_entries=length > LONG).value.T[:2]
        later[1, ends.box.size :] = 1
        return cls(ends, visits, scale * later * [[1], [-1]])

    def slopes(
        self, map: Any, params: Any, noise: Any, options: Any
    ) -> Float[np.ndarray, "causes"]:
        """Differentiate the logarithm of the mean time by parameters and a factor of the noise."""
        own = _OfBoth(map.field if isinstance(map, Flow) else map, False)
        function = _OfBoth(with_params(noise, 2, "noise"), True) if callable(noise) else None
        size, share = self.ends.box.size, self.ends.share
        here = self.later[:, :size]

        def changed(both: Any) -> Any:
            noisy: Any = function
            if function is None:
                noisy = tuple(both[1] * one for one in listed(noise, self.ends.box.dimensions))
            if isinstance(map, Flow):
                chain = diffusion_to(own, self.ends, both, noisy).chain
                ahead = (self.later[:, chain.image] - self.later[:, None]).sum(axis=0)
                return (chain.probability * ahead).sum(axis=0) @ self.visits
            about = {"noise": noisy, "onto": self.ends.around, **options}
            rows = traced_rows(own, self.ends.box, both, **about)
            into, outside = self.later[:, size : size + len(share)], self.later[:, -1]
            beyond = here[:, self.ends.nearest] * (1 - share.sum(axis=0)) + into @ share
            # Rows lack the probabilities of points outside of the box.
            past = outside[:, None] if len(self.ends.names) > len(share) else here
            ahead = (beyond[:, None] - past[:, :, None]).sum(axis=0)
            return (rows * ahead).sum(axis=1) @ self.visits[:size]

        known = {} if params is None else params
        slope, by_noise = jax.grad(changed)((jax.tree.map(jnp.asarray, known), jnp.asarray(1.0)))
        each = [float(one) for one in jax.tree.leaves(slope) if np.ndim(one) == 0]
        return np.array([*each, float(by_noise)])


@dataclasses.dataclass(frozen=True)
class _OfBoth:
    """A function of a point and of pairs of parameters and a factor of the noise."""

    function: Callable[..., Any]
    noisy: bool

    def __call__(self, x: Any, both: Any) -> Any:
        value = jnp.asarray(self.function(x, both[0]))
        return both[1] * value if self.noisy else value
