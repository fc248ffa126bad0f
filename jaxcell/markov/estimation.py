import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ..base.shown import Shown
from ..mapping.generalized import Chain
from ..mapping.sequence import ChainSequence, as_sequence


# Relative change of a stationary distribution at which the iteration ends, and most iterations.
_SETTLED, _ROUNDS = 1e-13, 200_000


@dataclasses.dataclass(frozen=True, eq=False)
class Spread(Shown):
    """A quantity of a chain with its sampling error, from a sample of chains."""

    value: np.ndarray
    "The quantity of the estimated chain."
    mean: np.ndarray
    "The mean over the sample."
    error: np.ndarray
    "The standard deviation over the sample; NaN if one of its numbers is not finite."
    low: np.ndarray
    "The 5 % quantile: with `high`, an interval of 90 %, in the mean over samples of its size."
    high: np.ndarray
    "The 95 % quantile over the sample."

    @classmethod
    def of(
        cls, quantity: Callable[[Chain], npt.ArrayLike], chain: Chain, sample: Iterable[Chain]
    ) -> "Spread":
        """Compute the quantity of a chain and of a sample of chains."""
        drawn = [np.asarray(quantity(one), float) for one in sample]
        # Other estimates of quantiles give intervals that are too short for small samples.
        low, high = np.quantile(drawn, [0.05, 0.95], axis=0, method="weibull")
        with np.errstate(invalid="ignore"):
            mean, error = np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1)
        return cls(*map(np.asarray, (quantity(chain), mean, error, low, high)))


def maximum_likelihood(counts: Any, *, reversible: bool = False) -> Chain:
    """Estimate the chain with the largest likelihood from numbers of observed steps.

    The probabilities are the shares of the steps from each cell. A reversible chain, whose flux
    `x_ij = pi_i p_ij` is symmetric, is found by iteration of `x_ij = (c_ij + c_ji) / (c_i / x_i +
    c_j / x_j)`, where `c_i` and `x_i` are sums of rows (Bowman et al. 2009; Trendelkamp-Schroer et
    al. 2015). It runs on the host.

    **Arguments:** the number of steps from each cell to each other cell, as a sparse or dense
    matrix; if `reversible`, all cells must reach each other. **Returns:** the chain.

    Ten steps from each of two cells:

        >>> from jaxcell import markov
        >>> markov.maximum_likelihood([[7, 3], [1, 9]]).to_scipy().toarray().tolist()
        [[0.7, 0.3], [0.1, 0.9]]
    """
    observed = _checked(counts)
    if not reversible:
        return _normalized(observed)
    if csgraph.connected_components(observed, connection="strong")[0] > 1:
        raise ValueError(
            "counts: expected cells that all reach each other, as a reversible chain has; keep the "
            "steps among the cells of one component"
        )
    both = (observed + observed.T).tocoo()
    begin, end = both.coords
    total = observed @ np.ones(observed.shape[0])
    share = total / total.sum()
    for _ in range(_ROUNDS):
        ratio = total / share
        flux = both.data / (ratio[begin] + ratio[end])
        last, share = share, np.bincount(begin, flux, share.size)
        share = share / share.sum()
        if np.abs(share / last - 1).max() <= _SETTLED:
            return _normalized(scipy.sparse.csr_array((flux, (begin, end)), both.shape))
    raise RuntimeError(
        f"maximum_likelihood: the reversible chain still changes after {_ROUNDS} iterations; "
        "parts of the chain are connected by very few steps"
    )


def posterior(
    counts: Any,
    quantity: Callable[[Chain], npt.ArrayLike],
    samples: int = 100,
    seed: int = 0,
    *,
    prior: float | int = 0,
) -> Spread:
    """Estimate a quantity of a chain from observed steps, with its interval.

    The probabilities of each cell have a Dirichlet distribution, whose parameters are the numbers
    of steps plus `prior`, for the observed kinds of steps; other steps have probability 0. The
    mean without a prior is the chain of maximum likelihood. It runs on the host.

    **Arguments:** numbers of steps as for [`maximum_likelihood`][]; a function of a chain, whose
    result has the same shape for every chain; the number of samples, from 19; their seed; and the
    number that is added to each number of steps. **Returns:** [`Spread`][].

    The probability of a step that was observed in 20 of 100 cases has a standard error of 4 %:

        >>> from jaxcell import markov
        >>> counts = [[80, 20], [50, 50]]
        >>> moving = markov.posterior(counts, lambda chain: chain.to_scipy()[0, 1], 1000)
        >>> round(float(moving.value), 3), round(float(moving.error), 2)
        (0.2, 0.04)
    """
    if samples < 19:
        raise ValueError(f"samples: expected 19 or more, for quantiles of 5 %, got {samples}")
    if not 0 <= prior < np.inf:
        raise ValueError(f"prior: expected a number from 0, got {prior}")
    observed, random = _checked(counts), np.random.default_rng(seed)
    observed.data = observed.data + prior
    drawn = observed.copy()

    def draw() -> Chain:
        # Smaller numbers lose digits when they are divided by their sum.
        drawn.data = np.maximum(random.gamma(observed.data), np.finfo(float).tiny)
        return _normalized(drawn)

    return Spread.of(quantity, _normalized(observed), (draw() for _ in range(samples)))


@dataclasses.dataclass(frozen=True, eq=False)
class ChapmanKolmogorov(Shown):
    """The share of each set's walkers that are in it later, by a chain and as observed."""

    by_chain: Float[np.ndarray, "times sets"]
    seen: Float[np.ndarray, "times sets"]
    "The observed share; NaN if no walker began in the set."
    error: Float[np.ndarray, "times sets"]
    "The standard error of the observed share, for independent walkers."
    walkers: Int[np.ndarray, "times sets"]
    "The number of walkers that began in each set."


def chapman_kolmogorov(
    chain: Chain | ChainSequence,
    sets: Int[np.ndarray, "cells"],
    observed: Sequence[tuple[int, npt.ArrayLike, npt.ArrayLike]],
) -> ChapmanKolmogorov:
    """Test if walkers are a Markov chain, on sets of cells.

    If they are, the `n`-th power of the chain predicts their shares after `n` steps (Prinz et al.
    2011). It runs on the host.

    **Arguments:** a chain, or a sequence from its phase 0; the number of the set of each cell, or
    -1; and for each time the number of steps, the cells in which walkers began, and the cells in
    which they ended (-1 if they left the space). **Returns:** the shares that stay in each set.

    By the chain, half of the walkers in set 0 are still in it after a step, but only 1 of 4 is:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> chain = mapping.Chain.from_scipy(np.array([[0.5, 0.5], [0.0, 1.0]]))
        >>> origin, end = np.array([0, 0, 0, 0, 1]), np.array([0, 1, 1, 1, 1])
        >>> test = markov.chapman_kolmogorov(chain, np.array([0, 1]), [(1, origin, end)])
        >>> test.by_chain.tolist(), test.seen.tolist()
        ([[0.5, 1.0]], [[0.25, 1.0]])
    """
    steps, count = as_sequence(chain), int(sets.max(initial=-1)) + 1
    by_chain, seen = np.full((2, len(observed), count), np.nan)
    walkers = np.zeros((len(observed), count), np.int64)
    for time, (number, *cells) in enumerate(observed):
        origin, end = map(np.asarray, cells)
        last = np.where(end >= 0, np.append(sets, -1)[end], -1)
        for k in range(count):
            inside = sets[origin] == k
            walkers[time, k] = inside.sum()
            if inside.any():
                begin = np.bincount(origin[inside], minlength=steps.cells) / inside.sum()
                *_, later = steps.pushed(begin, number)
                by_chain[time, k] = min(1.0, float(later[sets == k].sum()))
                seen[time, k] = (last[inside] == k).mean()
    with np.errstate(invalid="ignore"):
        error = np.sqrt(seen * (1 - seen) / np.maximum(walkers, 1))
    return ChapmanKolmogorov(by_chain, seen, error, walkers)


def _checked(counts: Any) -> scipy.sparse.csr_array:
    """Return counts as a sparse matrix of positive numbers, with one in each row."""
    if not scipy.sparse.issparse(counts):
        counts = np.asarray(counts)
    matrix = scipy.sparse.csr_array(counts, dtype=float, copy=True)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"counts: expected as many rows as columns, got {matrix.shape}")
    if not (np.isfinite(matrix.data) & (matrix.data > 0)).all():
        raise ValueError(f"counts: expected numbers from 0, got {matrix.data.min()}")
    (none,) = np.nonzero(np.diff(matrix.indptr) == 0)
    if none.size:
        raise ValueError(f"counts: cell {none[0]} has no steps; leave it out")
    return matrix


def _normalized(weight: scipy.sparse.csr_array) -> Chain:
    total = np.repeat(weight @ np.ones(weight.shape[0]), np.diff(weight.indptr))
    rows = weight.data / total, weight.indices, weight.indptr
    return Chain.from_scipy(scipy.sparse.csr_array(rows, weight.shape))
