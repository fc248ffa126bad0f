"""Compare the peak memory of studies with the estimates before they begin.

    python experiments/benchmarks/memory_of_studies.py               # all cases
    python experiments/benchmarks/memory_of_studies.py "groups"      # cases whose names begin so

Each case runs in a process of its own, with 10^5 to 10^9 cells. The script prints a Markdown table
of the memory of these processes.
"""

import os
import subprocess
import sys
import time
from typing import Any

from jaxcell import bundled, study
from jaxcell.base import memory


ENDS: dict[str, Any] = {"bounces": (45.0, 90.0), "start": "0", "goal": "50"}
TURNS: dict[str, Any] = {"bounces": (45.0, 90.0), "reliability": 0.8}
CASES: dict[str, tuple[type[study.CellStudy], str, dict[str, Any]]] = {
    "groups of a hall": (
        study.Groups,
        "room_200x125",
        {"bounce": (90.0,), "cell": 0.125, "directions": 360},
    ),
    "groups of a lab": (study.Groups, "lab_a", {"bounce": (45.0,), "cell": 0.001}),
    "groups among slanted walls": (
        study.Groups,
        "cafe",
        {"bounce": (90.0,), "cell": 0.01, "directions": 72},
    ),
    "groups among slanted walls, 360 directions": (
        study.Groups,
        "cafe",
        {"bounce": (90.0,), "cell": 0.005, "directions": 360},
    ),
    "filter": (study.Localize, "lab_a", {"bounce": 45.0, "cell": 0.01}),
    "choice of angles": (study.Localize, "lab_a", {"bounces": (45.0, 90.0), "cell": 0.02}),
    "plan": (study.Navigate, "lab_a", {**ENDS, "cell": 0.005}),
    "cover": (study.Cover, "lab_a", {**TURNS, "error": 45.0, "directions": 8, "cell": 0.01}),
    "cover by sure turns": (
        study.Cover,
        "lab_a",
        {**TURNS, "reliability": 1.0, "error": 0.0, "directions": 360, "cell": 0.05},
    ),
    "cover with wide errors": (
        study.Cover,
        "complex",
        {**TURNS, "error": 30.0, "directions": 360, "cell": 0.25},
    ),
    "team": (study.Team, "lab_a", {"bounce": (90.0,), "cell": 0.01}),
    "patrol of a map": (study.PatrolMap, "lab_a", {"cell": 0.2}),
}


# Without a cache of compiled programs, compilation is part of the peak.
_COLD = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}


def measure(name: str) -> None:
    """Print the row of a case, in a new process."""
    from jaxcell import record
    from jaxcell.base.runtime import configure_jax

    configure_jax()
    kind, place, options = CASES[name]
    question = kind(map=bundled(f"maps/{place}.json"), **options)
    estimate = memory.LIBRARIES + question.memory()
    began = time.process_time()
    result = question.run()
    record.summary(result)
    seconds = time.process_time() - began
    with open("/proc/self/status") as file:
        peak = next(int(line.split()[1]) * 1024 for line in file if line.startswith("VmHWM:"))
    cells = result.cells.size  # type: ignore[attr-defined]
    numbers = f"{cells:,} | {estimate / 1e9:.2f} GB | {peak / 1e9:.2f} GB | {estimate / peak:.2f}"
    print(f"| {name} | {numbers} | {seconds:.1f} s |", flush=True)


def main() -> None:
    begins = sys.argv[1] if len(sys.argv) > 1 else ""
    print("| study | cells | estimate | peak | ratio | processor |")
    print("| --- | --: | --: | --: | --: | --: |", flush=True)
    for name in CASES:
        if name.startswith(begins):
            subprocess.run([sys.executable, __file__, "--measure", name], check=True, env=_COLD)


if __name__ == "__main__":
    measure(sys.argv[2]) if sys.argv[1:2] == ["--measure"] else main()
