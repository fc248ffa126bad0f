"""Time the observations of robots that start anywhere, by sets of places on walls.

Run `python experiments/benchmarks/bench_anywhere.py`; it takes a minute.

Known headings are the directions of a map. Unknown headings are divided into 360 slices. The chords
are computed once per room. The first observation, which all places in the room may explain, is
timed separately. The other observations are those of robots that drive 20 times to a wall and
measure each run to within 5 cm.
"""

import math
import time

import numpy as np
from rows import Row, options, write_rows
from timing import begin, header, line

from experiments.shared.data import MAPS
from jaxcell.space import Workspace
from jaxcell.walls import Errors, WallFilter, places_anywhere, run_to_wall


CASES = (("complex", 32), ("cafe", 32), ("complex", None), ("cafe", None))
BOUNCE, BUMPS = math.radians(135), 20


def observed(room: Workspace, filter: WallFilter, headings: int | None, robots: int) -> np.ndarray:
    """Time each observation of robots that are followed one by one: seconds `[robots, bumps]`."""
    rng = np.random.default_rng(0)
    places = places_anywhere(room, robots, rng)
    seconds = np.empty((robots, BUMPS))
    for robot in range(robots):
        place = places[robot : robot + 1]
        heading = rng.uniform(0, math.tau, 1)
        if headings is not None:
            heading = rng.integers(headings, size=1) * math.tau / headings
        state = None
        for bump in range(BUMPS):
            wall, arc, run = run_to_wall(filter.boundary, place, heading)
            began = time.perf_counter()
            state = filter.turn(filter.observe(state, run), BOUNCE)
            seconds[robot, bump] = time.perf_counter() - began
            place, heading = filter.boundary.point(wall, arc), heading + BOUNCE
    return seconds


def main() -> None:
    arguments = options(__doc__, repeats=20).parse_args()
    begin("numpy")
    header("case", "size", "chords, s", "first, ms", "median, ms", "99 %, ms", words=2)
    rows = []
    for name, headings in CASES:
        room = Workspace.load(MAPS / f"{name}.json")
        began = time.perf_counter()
        filter = WallFilter.of(room, headings=headings, errors=Errors(distance=0.05))
        made = time.perf_counter() - began
        seconds = observed(room, filter, headings, arguments.repeats)
        first, rest = float(seconds[0, 0]), seconds[:, 1:]
        size = f"{name}, {headings or 'any'} heading{'s' if headings else ''}"
        times = f"{1e3 * np.median(rest):.2f}", f"{1e3 * np.quantile(rest, 0.99):.1f}"
        chords = f"{len(filter.chords.wall):,} chords"
        line(size, chords, f"{made:.2f}", f"{1e3 * first:.0f}", *times)
        rows.append(Row("anywhere", "an observation, sets on walls", size, float(np.median(rest))))
        rows.append(Row("anywhere", "chords and first observation", size, made + first))
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
