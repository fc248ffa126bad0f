"""Time maximum-likelihood fits of the generalized lambda distribution beside gldpy.

Run `python experiments/benchmarks/bench_gld.py`; our fits take about 20 s. gldpy starts from
L-moments; by default it fits 300 samples, which takes it about 10 s per law. With `--samples 5000`
it takes minutes per law. `--full` adds more laws.

Both programs fit the same continuous samples. The table has the log-likelihoods of both, which this
script computes from the quantile function of the law (Alam 2018, Eq. 4.10) by bisection. Samples of
whole numbers are fitted by our program only, because the likelihood that gldpy maximizes is
unbounded for them.
"""

import warnings
from collections.abc import Sequence
from typing import Any

import gldpy
import numpy as np
import scipy.stats
from rows import Row, options, write_rows
from timing import Timing, begin, header, line, take_turns, timed

from jaxcell.patrol.law.fit import fit_gld


CONTINUOUS = {"normal": scipy.stats.norm(3, 2), "exponential": scipy.stats.expon(scale=5)}
WHOLE = {"geometric": scipy.stats.geom(0.03)}
MORE_CONTINUOUS = {
    "logistic": scipy.stats.logistic(),
    "uniform": scipy.stats.uniform(-1, 3),
    "Student, 3": scipy.stats.t(3),
    "lognormal": scipy.stats.lognorm(0.8),
}
MORE_WHOLE = {"negative binomial": scipy.stats.nbinom(3, 0.1), "Poisson": scipy.stats.poisson(900)}


@np.errstate(all="ignore")
def log_likelihood(law: Sequence[float], samples: np.ndarray, whole: bool) -> float:
    """Compute the log-likelihood of a law; a whole number stands for the interval around it."""
    l1, l2, l3, l4 = law

    def power(u: np.ndarray, shape: float) -> np.ndarray:
        return np.log(u) if shape == 0 else (u**shape - 1) / shape

    def quantile(u: np.ndarray) -> np.ndarray:
        return l1 + (power(u, l3) - power(1 - u, l4)) / l2

    def below(x: np.ndarray) -> np.ndarray:
        low, high = np.zeros(x.shape), np.ones(x.shape)
        for _ in range(100):
            middle = (low + high) / 2
            less = quantile(middle) < x
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return low

    if whole:
        return float(np.log(below(samples + 0.5) - below(samples - 0.5)).sum())
    u = below(samples)
    inside = (quantile(np.zeros(1)) <= samples) & (samples <= quantile(np.ones(1)))
    density = l2 / (u ** (l3 - 1) + (1 - u) ** (l4 - 1))
    return float(np.log(np.where(inside, density, 0)).sum())


def ours(name: str, samples: np.ndarray, repeats: int) -> float:
    """Print our fit, and return the median of its seconds."""
    found: dict[str, Any] = {}
    timing = take_turns({"jaxcell": lambda: fit_gld(samples)}, repeats, found.update)["jaxcell"]
    fit = found["jaxcell"]
    law = [fit.law.l1, fit.law.l2, fit.law.l3, fit.law.l4]
    row(name, samples, "jaxcell", timing, log_likelihood(law, samples, fit.censored))
    return timing.median


def by_gldpy(name: str, samples: np.ndarray) -> float | None:
    """Print the fit of gldpy, and return its seconds; `None` if it fails."""
    quiet = {"disp_optimizer": False, "disp_fit": False}
    guess = {"method": "LMM", "initial_guess": (0.1, 0.1)}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            seconds, parameters = timed(lambda: gldpy.GLD("FMKL").fit_ML(samples, **guess, **quiet))
    except Exception as error:  # gldpy does not document its error for a failed start.
        line(name, f"{samples.size:,}", "gldpy", f"{type(error).__name__}: {error}")
        return None
    law = [float(parameter) for parameter in parameters]
    timing = Timing.of(seconds, [seconds])
    row(name, samples, "gldpy", timing, log_likelihood(law, samples, False))
    return seconds


def row(name: str, samples: np.ndarray, program: str, timing: Timing, reached: float) -> None:
    seconds = (f"{one:.3f}" for one in timing)
    line(name, f"{samples.size:,}", program, *seconds, f"{reached:.3f}")


def main() -> None:
    parser = options(__doc__, repeats=5, full="more laws")
    parser.add_argument("--samples", type=int, default=300, help="number of samples for gldpy")
    arguments = parser.parse_args()
    begin("jax", "numpy", "scipy", "gldpy")
    continuous, whole = CONTINUOUS, WHOLE
    if arguments.full:
        continuous, whole = {**CONTINUOUS, **MORE_CONTINUOUS}, {**WHOLE, **MORE_WHOLE}
    times = ("first call, s", "min, s", "median, s")
    header("law", "samples", "program", *times, "log-likelihood", words=3)
    rows = []
    for name, law in {**continuous, **whole}.items():
        seconds = ours(name, law.rvs(5000, random_state=0), arguments.repeats)
        rows.append(Row("gld", f"fit of samples, {name} law", "5,000 samples", seconds))
    for name, law in continuous.items():
        samples = law.rvs(arguments.samples, random_state=0)
        seconds = ours(name, samples, arguments.repeats)
        size, theirs = f"{samples.size:,} samples", by_gldpy(name, samples)
        rows.append(Row("gld", f"fit of samples, {name} law", size, seconds, "gldpy", theirs))
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
