"""Time members of a sweep of attack times, beside a loop over single studies.

Run `python experiments/benchmarks/bench_attacks.py`; it takes about 20 s of a processor.

A member is an attack time from 1 on, and the least probability of capture by given walks: of two
robots on a graph of 50 vertices, if the adversary sees them and if it is blind, and of two robots
on the map of a depot. The loop runs the study of one member. Results have the same bytes.
"""

from typing import Any

import numpy as np
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, table, take_turns

from jaxcell.study import PatrolGraph, PatrolMap
from jaxcell.sweep.study_task import member_study, study_task


GRAPH = "attack_time", PatrolGraph, {"file": "@random", "robots": 2}
MAP = "attack_times", PatrolMap, {"map": "@depot", "robots": 2}
RESULTS = {PatrolGraph: ["least_capture", "least_blind_capture"], PatrolMap: ["least_capture"]}
MEMBERS, FEW = 100, [49]


def attacks(name: str, study: Any, fixed: dict[str, Any], size: str, repeats: int) -> list[Row]:
    batch, names = {name: np.arange(1, MEMBERS + 1)}, RESULTS[study]

    def loop() -> np.ndarray:
        studies = [member_study(study, {**fixed, name: batch[name][i].item()}, 0) for i in FEW]
        return np.array([[getattr(one.run(), each) for each in names] for one in studies])

    def together() -> np.ndarray:
        columns = study_task(study, batch, fixed, 0, names)
        return np.stack([columns[each][1] for each in names], axis=1)

    def check(results: dict[str, Any]) -> None:
        found, expected = results.values()
        np.testing.assert_array_equal(found[FEW], expected)

    programs = {"jaxcell, a batch": together, "jaxcell, single studies": loop}
    timings = take_turns(programs, repeats, check)
    parts = zip(timings.items(), (MEMBERS, len(FEW)), strict=True)
    each = {program: Timing(*(one / count for one in timing)) for (program, timing), count in parts}
    table(f"Capture per attack time, {size}", each)
    return rows_of("attacks", "capture of attacks per attack time", size, each)


def main() -> None:
    arguments = options(__doc__, repeats=3).parse_args()
    begin("jax", "numpy", "scipy")
    rows = attacks(*GRAPH, "50 vertices x 100", arguments.repeats)
    rows += attacks(*MAP, "188 cells x 100", arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
