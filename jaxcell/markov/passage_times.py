import functools
import math

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Float

from ..base.certificate import Certificate, Solution
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.generalized import ChainLike, leaving_rows
from ..mapping.traced import like, on_host
from .hitting import TOLERANCE, Cells, cell_mask, hitting_times, with_moved
from .passage import start_distribution
from .quasi import slowest_part
from .traced import CERTIFIED, expected
from .transient import Transient


_HALF_ULP = 2.0**-53
# Of times up to this number, differences between the times of two cells have some digits.
_LONG = 2.0**50
# A probability that is smaller than a level by this part of it equals it.
_TIE = 1e-12
# Largest number of cells whose matrix is squared, of squarings, and of single steps of more cells.
_DENSE, _SQUARINGS, _STEPS = 1000, 1000, 100_000
# Number of squarings after which later times may be taken as geometric, and relative difference of
# distributions from different starts that counts as rounding.
_EXACT, _EQUAL = 10, 1e-12
# Distance, as a sum of differences, at which a distribution counts as quasi-stationary, and the
# number of steps between two checks.
_SETTLED, _BETWEEN = 1e-9, 50


def passage_time_variance(
    chain: ChainLike, target: npt.ArrayLike | int, *, throw: bool = True
) -> Solution:
    """Compute the variance of the number of steps until a chain first reaches a set of cells.

    With the expected times `t`, it is the expected sum of the squares of `1 + t(next) - t(now)`,
    the changes of the predicted time, so that a certain time has the variance 0. Only for more than
    10^15 steps it is the second moment minus the square of the mean.

    **Arguments:** as for [`jaxcell.markov.hitting_times`][]. **Returns:** the variance for each
    start, 0 in the target, and `inf` where the expected time is infinite. The residual of the
    certificate bounds the error of every variance, relative to the second moment.

    A robot that stays with probability 3/4 in each step, or moves on to the last cell:

        >>> from jaxcell import markov
        >>> markov.passage_time_variance([[0.75, 0.25], [0.0, 1.0]], target=1).value.tolist()
        [12.0, 0.0]
    """
    require_x64("passage_time_variance")
    there = cell_mask(chain.cells, target)
    found = hitting_times(chain, there, throw=False)
    time, inside = found.value, (found.value > 0) & jnp.isfinite(found.value)
    form = like(float, chain.cells), *CERTIFIED
    given = chain, inside, time, found.certificate.residual
    value, products, error = on_host(_variance, form, *given)
    certificate = Certificate(found.certificate.iterations + products, error, TOLERANCE)
    if throw and not traced(value) and np.isinf(value).any():
        raise RuntimeError(
            "passage_time_variance: a variance is above 1e308, too large for 64 bits; throw=False "
            "returns inf for it"
        )
    certificate.check("passage_time_variance", throw)
    if traced(chain, time):
        finite = jnp.where(inside, time, 0.0)
        change = jnp.where(inside[None], finite[chain.image] + 1 - finite[None], 0.0)
        gain = jnp.sum(chain.probability * change**2, axis=0)
        value = expected(value, chain, inside, gain)
    value = jnp.where(inside, value, time)
    return with_moved(
        Solution(put_on_device(value), certificate), chain, passage_time_variance, there
    )


def _variance(
    matrix: scipy.sparse.csr_array,
    inside: Cells,
    time: Float[np.ndarray, "cells"],
    relative: float,
) -> tuple[Float[np.ndarray, "cells"], int, float]:
    """Compute the variances in the cells `inside` from the times and their relative error."""
    part = Transient.of(matrix, inside)
    time = np.where(inside, time, 0.0)
    row = np.repeat(np.arange(time.size), np.diff(matrix.indptr))
    value = np.zeros(time.size)
    with np.errstate(all="ignore"):
        change = np.where(inside[row], time[matrix.indices] + 1 - time[row], 0.0)
        gain = np.bincount(row, matrix.data * change**2, time.size)[inside]
        later = (matrix @ time)[inside]
        found = part.expect(np.stack([gain, later], axis=1))
        mean = time[inside]
        second = mean + 2 * found.value[:, 1]
        plain = np.maximum(second - mean**2, 0)
        value[inside] = found.value[:, 0] if mean.max(initial=0) < _LONG else plain
        value[np.isnan(value)] = np.inf
        # The second moment is a sum of products of positive numbers, and its error is known.
        rounding = 2 * found.error[:, 1] / second + 3 * relative + 8 * _HALF_ULP
        error = np.abs(value[inside] - (second - mean**2)) / second + rounding
    most = float(error.max(initial=0.0))
    return value, found.products, math.inf if math.isnan(most) else most


def passage_quantiles(
    chain: ChainLike,
    start: npt.ArrayLike | int,
    target: npt.ArrayLike | int,
    levels: npt.ArrayLike = (0.05, 0.5, 0.95),
) -> Float[Array, "levels"]:
    """Compute quantiles of the number of steps until a chain first reaches a set of cells.

    The quantile of a level is the least number of steps after which the chain has arrived with at
    least this probability; [`jaxcell.markov.first_passage`][] is the law, step by step.

    If at most 1,000 cells matter, their matrix is squared, and the digits of the quantile follow
    one by one, until the distribution of a chain that has not arrived is quasi-stationary; later
    times are geometric. Probabilities of arriving are sums of positive numbers, so that times of
    1e300 steps are no problem. Of more cells, single steps are followed until the same holds.

    **Arguments:** a start and a target as for `first_passage`, and levels above 0 and below 1.
    **Returns:** the number of steps for each level, and `inf` if the chain arrives with a smaller
    probability. Under `grad` they count as constant.

    **Raises:** `RuntimeError` if the distribution on more cells still changes after 100,000 steps.

    A robot that stays with probability 3/4 in each step, or moves on to the last cell:

        >>> from jaxcell import markov
        >>> P = [[0.75, 0.25], [0.0, 1.0]]
        >>> markov.passage_quantiles(P, start=0, target=1, levels=[0.25, 0.5, 0.99]).tolist()
        [1.0, 3.0, 17.0]
    """
    require_x64("passage_quantiles")
    level = np.atleast_1d(np.asarray(levels, float))
    if level.ndim != 1 or not ((level > 0) & (level < 1)).all():
        raise ValueError(f"levels: expected numbers above 0 and below 1, got {level.tolist()}")
    given = start_distribution(chain.cells, start), cell_mask(chain.cells, target)
    compute = functools.partial(_quantiles, levels=tuple(level.tolist()))
    value: Array = put_on_device(on_host(compute, like(float, level.size), chain, *given))
    return value


def _quantiles(
    matrix: scipy.sparse.csr_array,
    start: Float[np.ndarray, "cells"],
    there: Cells,
    levels: tuple[float, ...],
) -> Float[np.ndarray, "levels"]:
    if not there.any() or np.isnan(start).any():
        raise ValueError("start, target")
    before = scipy.sparse.csr_array(scipy.sparse.diags_array((~there).astype(float)) @ matrix)
    before.eliminate_zeros()
    inside = ~there & reaching(before, there) & reaching(before.T.tocsr(), start > 0)
    cells = np.flatnonzero(inside)
    rows = matrix[cells]
    step, arrive = rows[:, cells], rows @ there.astype(float)
    lost = rows @ (~inside & ~there).astype(float) + leaving_rows(rows)
    find = _by_squares if cells.size <= _DENSE else _by_steps
    wanted = np.array(levels) * (1 - _TIE)
    return find(step, arrive, lost, start[cells], float(start[there].sum()), wanted)


def _by_squares(
    step: scipy.sparse.csr_array,
    arrive: Float[np.ndarray, "part"],
    lost: Float[np.ndarray, "part"],
    start: Float[np.ndarray, "part"],
    already: float,
    levels: Float[np.ndarray, "levels"],
) -> Float[np.ndarray, "levels"]:
    powers, arrived, limit, first = [step.toarray()], [arrive], None, lost
    while already + start @ arrived[-1] < levels.max() and len(powers) < _SQUARINGS:
        power = powers[-1]
        arrived.append(arrived[-1] + power @ arrived[-1])
        lost = lost + power @ lost
        powers.append(power @ power)
        # The sum of a row is known with all its digits unless nearly all of it is gone.
        stays, total = 1 - arrived[-1] - lost, powers[-1].sum(axis=1)
        rows = powers[-1][total > 0] / total[total > 0, None]
        powers[-1] *= np.where(stays > 0.5, stays / np.maximum(total, 0.25), 1)[:, None]
        if not start @ total:
            break
        # Distributions from all starts are equal in every entry, so that later times are geometric.
        if len(powers) > _EXACT and (np.ptp(rows, axis=0) <= _EQUAL * rows.max(axis=0)).all():
            limit = rows[0]
            break
    time, sure = np.where(levels <= already, 0.0, np.inf), already + start @ arrived[-1]
    if limit is not None:
        total = (start @ powers[-1]).sum()
        later = _geometric(levels, sure, total, limit, arrive, first)
        time = np.where(levels > sure, 2.0 ** (len(powers) - 1) + later, time)
    for number in np.flatnonzero((levels > already) & (levels <= sure)):
        # Find the largest number of steps that is too few, one binary digit after the other.
        steps, now, sure = 0, start, already
        for digit in reversed(range(len(powers) - 1)):
            if (more := sure + now @ arrived[digit]) < levels[number]:
                steps, now, sure = steps + 2**digit, now @ powers[digit], more
        time[number] = steps + 1
    return time


def _by_steps(
    step: scipy.sparse.csr_array,
    arrive: Float[np.ndarray, "part"],
    lost: Float[np.ndarray, "part"],
    now: Float[np.ndarray, "part"],
    sure: float,
    levels: Float[np.ndarray, "levels"],
) -> Float[np.ndarray, "levels"]:
    time, back, limit = np.where(levels <= sure, 0.0, np.inf), step.T.tocsr(), np.zeros(lost.size)
    for steps in range(1, _STEPS + 1):
        sure, now = sure + arrive @ now, back @ now
        time[(levels <= sure) & np.isinf(time)] = steps
        later, total = np.isinf(time), now.sum()
        if not later.any() or total == 0:
            return time
        if steps % _BETWEEN:
            continue
        if steps == _BETWEEN:
            part, found = slowest_part(step, np.ones(lost.size, bool))
            limit[part] = found.value
        if np.abs(now / total - limit).sum() <= _SETTLED:
            wanted = _geometric(levels, sure, total, limit, arrive, lost)
            return np.where(later, steps + wanted, time)
    raise RuntimeError(
        f"passage_quantiles: after {_STEPS} steps the chain has not arrived, and its distribution "
        "still changes; ask for smaller levels, or use passage_time_variance"
    )


def _geometric(
    levels: Float[np.ndarray, "levels"],
    sure: float,
    total: float,
    limit: Float[np.ndarray, "part"],
    arrive: Float[np.ndarray, "part"],
    lost: Float[np.ndarray, "part"],
) -> Float[np.ndarray, "levels"]:
    """Compute the steps to each level from a mass `total` with the quasi-stationary `limit`."""
    out = limit @ (arrive + lost)
    with np.errstate(all="ignore"):
        wanted = np.log1p((sure - levels) * out / (total * (limit @ arrive))) / np.log1p(-out)
    return np.where(np.isnan(wanted), np.inf, np.ceil(wanted))
