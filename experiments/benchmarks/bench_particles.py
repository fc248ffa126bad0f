"""Time drifters without cells in a changing current beside Parcels 3.

    python experiments/benchmarks/bench_particles.py --parcels PYTHON

The script prints a Markdown table. README.md in this folder explains the measurements. Drifters
follow the surface of the bundled sea for 23 hours by the Runge-Kutta method, in steps of 5 minutes,
on squares of 1 km. `PYTHON` is an interpreter with Parcels 3. It stores velocities in 32 bits, so
the ends agree to some centimetres.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np
from rows import Row, options, write_rows
from timing import begin, header, line, take_turns

from jaxcell import bundled, drift


CELL, STEP, HOURS = 1000.0, 300.0, 23
# The largest difference of two ends, in metres.
AGREEMENT = 1.0


def by_parcels(python: Path, current: dict[str, np.ndarray]) -> tuple[np.ndarray, float]:
    """Run Parcels, and return the ends `[2, drifters]` and the seconds."""
    with tempfile.TemporaryDirectory() as folder:
        given, out = (str(Path(folder) / name) for name in ("in.npz", "out.npz"))
        np.savez(given, **current, step=STEP, end=3600 * HOURS)
        program = str(Path(__file__).with_name("parcels_drifters.py"))
        subprocess.run([str(python), program, given, out], check=True)
        ends = np.load(out)
        return np.stack([ends["x"], ends["y"]]), float(ends["seconds"])


def main() -> None:
    parser = options(__doc__, repeats=3, full="a million drifters")
    parser.add_argument("--parcels", type=Path, metavar="PYTHON", help="Python with Parcels 3")
    arguments = parser.parse_args()
    begin("jax", "numpy")
    header("drifters", "jaxcell, s", "Parcels 3, s", "ratio", words=0)
    currents = drift.open_currents(bundled("ocean/gyres.nc"), depths=0)
    u, v = (np.nan_to_num(currents[name].values[:, 0].astype(float)) for name in "uv")
    times, rows, columns = u.shape
    axes = {"lon": CELL * np.arange(columns), "lat": CELL * np.arange(rows)}
    axes["time"] = 3600.0 * np.arange(times)
    flow = drift.Flow(np.stack([u, v], axis=1) / CELL, axes["time"])
    table = []
    for count in (100_000, 1_000_000) if arguments.full else (100_000,):
        random = np.random.default_rng(0)
        x, y = random.uniform(2, columns - 3, count), random.uniform(2, rows - 4, count)

        def ours(x: np.ndarray = x, y: np.ndarray = y) -> tuple[jax.Array, jax.Array]:
            steps = round(3600 * HOURS / STEP)
            return drift.advect(flow, x, y, 3600.0 * HOURS, method="rk4", steps=steps)

        seconds = take_turns({"jaxcell": ours}, arguments.repeats)["jaxcell"].median
        peer, taken = None, None
        if arguments.parcels is not None:
            given = {"U": u, "V": v, **axes, "x": CELL * x, "y": CELL * y}
            ends, taken = by_parcels(arguments.parcels, given)
            if not (off := np.abs(ends - CELL * np.stack(ours())).max()) <= AGREEMENT:
                sys.exit(f"ends differ by {off:g} m")
            peer = "Parcels 3, compiled"
        row = Row("particles", "drifters, 276 steps", f"{count:,} drifters", seconds, peer, taken)
        ratio = "" if row.ratio is None else f"{row.ratio:.1f}"
        line(f"{count:,}", f"{seconds:.3f}", "" if taken is None else f"{taken:.3f}", ratio)
        table.append(row)
    write_rows(arguments.rows, table)


if __name__ == "__main__":
    main()
