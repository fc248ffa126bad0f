"""Time benchmarks: every program is called once, checked, and then timed in turns."""

import os
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
from machine import version


class Timing(NamedTuple):
    """The wall-clock seconds of a program: of its first call, and of the later ones."""

    first: float
    least: float
    median: float

    @classmethod
    def of(cls, first: float, turns: list[float]) -> "Timing":
        return cls(first, min(turns), statistics.median(turns))


def begin(*packages: str) -> None:
    """Turns on 64-bit numbers, as the command line does, and says what is timed on what.

    There is no cache of compiled programs, so first calls compile.
    """
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    versions = ", ".join(f"{name} {version(name) or '(not installed)'}" for name in packages)
    print(f"{versions}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n", flush=True)


def timed(program: Callable[[], Any]) -> tuple[float, Any]:
    """The seconds of one call, until the arrays of its result are there, and the result."""
    began = time.perf_counter()
    result = jax.block_until_ready(program())
    return time.perf_counter() - began, result


def take_turns(
    programs: Mapping[str, Callable[[], Any]],
    repeats: int,
    check: Callable[[dict[str, Any]], None] = lambda results: None,
    patience_s: float = 10.0,
) -> dict[str, Timing]:
    """Times several programs side by side.

    Each is called once, which compiles it, and `check` gets all results, to raise where they
    differ. Then they take turns.

    **Arguments:**

    - `programs`: by name; the first is ours.
    - `repeats`: the number of turns.
    - `patience_s`: a program that has taken more seconds than this in its turns has no further
        one. A peer whose first call takes that long has none at all, and its first call counts.
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
    """Prints a line of a Markdown table, at once."""
    print(f"| {' | '.join(map(str, entries))} |", flush=True)
