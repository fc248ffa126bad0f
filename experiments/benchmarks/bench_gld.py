"""Times maximum-likelihood fits of the generalized lambda distribution beside those of gldpy.

Run `python experiments/benchmarks/bench_gld.py`; ours takes about 20 s. gldpy is no dependency;
where it is installed it is run too, by default on 300 samples, which takes it about 10 s a law
from its start by L-moments. `--samples 5000` takes it minutes a law.

Both fit the same continuous samples. What counts is the log-likelihood that they reach, by our
density for both. Samples of whole numbers are fitted by ours alone: for them the likelihood that
gldpy maximises has no bound.
"""

import argparse
import os
import statistics
import time
import warnings
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import scipy.stats

from jaxcell.patrol.lambda_distribution import Gld
from jaxcell.patrol.lambda_fit import fit_gld


try:
    import gldpy
except ImportError:
    gldpy = None


CONTINUOUS = {
    "normal": scipy.stats.norm(3, 2),
    "logistic": scipy.stats.logistic(),
    "exponential": scipy.stats.expon(scale=5),
    "uniform": scipy.stats.uniform(-1, 3),
    "Student, 3": scipy.stats.t(3),
    "lognormal": scipy.stats.lognorm(0.8),
}
WHOLE = {
    "geometric": scipy.stats.geom(0.03),
    "negative binomial": scipy.stats.nbinom(3, 0.1),
    "Poisson": scipy.stats.poisson(900),
}


def timed(program: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = program()
    return time.perf_counter() - began, result


def ours(name: str, samples: np.ndarray, repeats: int) -> None:
    first, fit = timed(lambda: fit_gld(samples))
    again = [timed(lambda: fit_gld(samples))[0] for _ in range(repeats)]
    row(name, samples, "jaxcell", f"{first:.2f}", again, fit.log_likelihood)


def by_gldpy(name: str, samples: np.ndarray) -> None:
    def program() -> Any:
        return gldpy.GLD("FMKL").fit_ML(
            samples,
            method="LMM",
            initial_guess=(0.1, 0.1),
            disp_optimizer=False,
            disp_fit=False,
        )

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            seconds, parameters = timed(program)
    except Exception as error:  # What it raises where it finds no start is not documented.
        print(f"| {name} | {samples.size:,} | gldpy | {type(error).__name__}: {error} |")
        return
    law = Gld(*(float(parameter) for parameter in parameters))
    row(name, samples, "gldpy", "", [seconds], float(law.log_pdf(samples).sum()))


def row(
    name: str, samples: np.ndarray, program: str, first: str, seconds: list[float], reached: float
) -> None:
    print(
        f"| {name} | {samples.size:,} | {program} | {first} | {min(seconds):.3f} | "
        f"{statistics.median(seconds):.3f} | {reached:.3f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--samples", type=int, default=300, help="that gldpy gets")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    print(
        f"jax {jax.__version__}, numpy {np.__version__}, scipy {scipy.__version__}, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n"
    )
    if gldpy is None:
        print("gldpy is not installed: ours alone\n")
    print("| law | samples | program | first call, s | min, s | median, s | log-likelihood |")
    print("|---|--:|---|--:|--:|--:|--:|")
    for name, law in {**CONTINUOUS, **WHOLE}.items():
        ours(name, law.rvs(5000, random_state=0), arguments.repeats)
    if gldpy is not None:
        for name, law in CONTINUOUS.items():
            samples = law.rvs(arguments.samples, random_state=0)
            ours(name, samples, arguments.repeats)
            by_gldpy(name, samples)


if __name__ == "__main__":
    main()
