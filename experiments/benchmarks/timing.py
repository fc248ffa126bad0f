"""Time programs: each is called once, the results are checked, and then the programs take turns."""

import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
from machine import version


class Timing(NamedTuple):
    """The seconds of a program: its first call, and the least and the median of its turns."""

    first: float
    least: float
    median: float

    @classmethod
    def of(cls, first: float, turns: list[float]) -> "Timing":
        return cls(first, min(turns), statistics.median(turns))


def begin(*packages: str) -> None:
    """Turn on 64-bit numbers, as the command line does, and print versions and the machine.

    First calls compile, because there is no cache of compiled programs.
    """
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    versions = ", ".join(f"{name} {version(name) or '(not installed)'}" for name in packages)
    print(f"{versions}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n", flush=True)


def timed(program: Callable[[], Any]) -> tuple[float, Any]:
    """Time one call until the arrays of its result are computed; return seconds and result."""
    began = time.perf_counter()
    result = jax.block_until_ready(program())
    return time.perf_counter() - began, result


def take_turns(
    programs: Mapping[str, Callable[[], Any]],
    repeats: int,
    check: Callable[[dict[str, Any]], None] = lambda results: None,
    patience_s: float = 10.0,
) -> dict[str, Timing]:
    """Time several programs.

    Each program is called once, which compiles it. Then the programs take turns.

    **Arguments:**

    - `programs`: programs by name; the first is ours.
    - `repeats`: number of turns.
    - `check`: a function of all results by name, which raises if they differ.
    - `patience_s`: seconds after which a program has no further turn. A peer whose first call takes
        that long has no turn, and its first call counts.
    """
    first, results = {}, {}
    for name, program in programs.items():
        first[name], results[name] = timed(program)
    check(results)
    del results
    ours = next(iter(programs))
    taken: dict[str, list[float]] = {
        name: [] if name == ours or first[name] < patience_s else [first[name]] for name in programs
    }
    for _ in range(repeats):
        for name, program in programs.items():
            if sum(taken[name]) < patience_s:
                taken[name].append(timed(program)[0])
    return {name: Timing.of(first[name], taken[name]) for name in programs}


def line(*entries: object) -> None:
    """Print a line of a Markdown table immediately."""
    print(f"| {' | '.join(map(str, entries))} |", flush=True)


def header(*names: str, words: int = 1) -> None:
    """Print the first lines of a Markdown table whose first `words` columns are text."""
    line(*names)
    line(*["---"] * words, *["--:"] * (len(names) - words))


def table(title: str, timings: Mapping[str, Timing]) -> None:
    """Print a Markdown table of programs, with the ratio of each median to that of the first."""
    print(f"\n### {title}\n")
    header("program", "first call, s", "least, s", "median, s", "to ours")
    ours = next(iter(timings.values())).median
    for name, timing in timings.items():
        line(name, *(f"{seconds:.4f}" for seconds in timing), f"{timing.median / ours:.2f}")


def peak_bytes() -> int:
    """Return the largest memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
