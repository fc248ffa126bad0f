"""Time members of a sweep that are computed in one program, beside a loop over single studies.

Run `python experiments/benchmarks/bench_members.py`; it takes about 30 s. With `--full` it also
runs the whole sweep of 10^5 members on two processes, the result and the store included, in about
2 min.

A member is a robot in `@lab_a` at 72 headings, with one of three angles and three errors, and a
reliability of its own: how near it comes to a uniform cover, with the duality gap, the share of
time in a goal, and the mean steps to it. The loop runs the study of some members one by one.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, table, take_turns

from jaxcell.study import Cover
from jaxcell.sweep import Spec, run_sweep
from jaxcell.sweep.study_task import member_study, study_task


RESULTS = ["distance", "duality_gap", "goal_share", "goal_time"]
SPEC = """
task = "cover"
results = {results}
chunk = {chunk}
[fixed]
map = "@lab_a"
directions = 72
goal = "7.5,1.5"
[grid]
bounce = [40, 90, 135]
errors_turn = [5, 10, 15]
reliability = {{start = 0.5, stop = 0.95, num = {count}}}
"""
# Number of members of the loop.
FEW = 20
# Largest relative difference of a batch and single studies.
AGREEMENT = 1e-9


def spec(folder: Path, count: int, chunk: int) -> Spec:
    path = folder / "cover.toml"
    path.write_text(SPEC.format(results=RESULTS, chunk=chunk, count=count))
    return Spec.load(path)


def members(folder: Path, repeats: int) -> list[Row]:
    what = spec(folder, 256, 9 * 256)
    batch = what.batch(what.chunk(0))
    size = len(batch["reliability"])
    few = range(0, size, size // FEW)

    def loop() -> np.ndarray:
        found = []
        for i in few:
            own = {name: column[i].item() for name, column in batch.items()}
            result = member_study(Cover, {**what.fixed, **own}, what.seed).run()
            found.append([getattr(result, name) for name in RESULTS])
        return np.array(found)

    def together() -> np.ndarray:
        columns = study_task(Cover, batch, what.fixed, what.seed, RESULTS)
        return np.stack([columns[name][1] for name in RESULTS], axis=1)

    def check(results: dict[str, Any]) -> None:
        found, expected = results.values()
        np.testing.assert_allclose(found[:: size // FEW], expected, rtol=AGREEMENT, atol=AGREEMENT)

    programs = {"jaxcell, a batch": together, "jaxcell, single studies": loop}
    timings = take_turns(programs, repeats, check)
    parts = zip(timings.items(), (size, len(few)), strict=True)
    each = {name: Timing(*(one / count for one in timing)) for (name, timing), count in parts}
    table(f"Coverage, duality gap, share and time of a goal per member, {size:,} members", each)
    return rows_of("members", "coverage and steps to a goal per member", f"{size:,}", each)


def whole(folder: Path) -> None:
    what = spec(folder, 11_112, 4 * 2778)
    began = time.perf_counter()
    status = run_sweep(what, folder / "out", engine="processes", workers=2)
    took = time.perf_counter() - began
    print(f"\nsweep of {9 * 11_112:,} members on two processes: {took:.0f} s, {status.complete=}")


def main() -> None:
    arguments = options(__doc__, repeats=3, full="a sweep of 10^5 members: 2 min").parse_args()
    begin("jax", "numpy", "scipy")
    with tempfile.TemporaryDirectory() as name:
        rows = members(Path(name), arguments.repeats)
        if arguments.full:
            whole(Path(name))
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
