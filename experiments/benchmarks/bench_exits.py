"""Time mean exit times along a parameter of a noisy map of the plane, beside a loop.

Run `python experiments/benchmarks/bench_exits.py`; it takes 5 to 10 min.

A particle jumps between two wells on 64 x 64 cells, with noise at each mapping. Its mean time until
the other well, and the derivative by the depth of the wells, are computed for 1,000 depths. The
loop calls `dynamics.escape` without derivatives for one of them.
"""

import jax
import jax.numpy as jnp
import numpy as np
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, table, take_turns

from jaxcell import dynamics
from jaxcell.space import Box


CELLS, MEMBERS = 64, 1000
ABOUT = {"noise": 0.15, "start": [-1.0, 0.0], "into": lambda x: x[:, 0] > 0}
# Largest relative difference of both programs.
AGREEMENT = 1e-6


def well(x, p):
    return jnp.stack([x[0] + 0.3 * (p["a"] * x[0] - x[0] ** 3) + 0.1 * x[1], 0.5 * x[1]])


def exits(repeats: int) -> list[Row]:
    box = Box([-2, -2], [2, 2], [CELLS, CELLS], "clamp")
    system = dynamics.System(well, box, {"a": 1.0})
    values = np.linspace(0.9, 1.1, MEMBERS)

    def together() -> float:
        found = dynamics.exit_times(system, "a", values, **ABOUT)
        print(
            f"{found.solved} chains solved, {found.alone.sum()} members alone, residual "
            f"{found.residual.max():.1e}"
        )
        slope = np.gradient(np.log(found.mean_time), values, edge_order=2)
        own = found.derivative / found.mean_time
        print(f"largest relative difference of slopes: {np.abs(slope / own - 1)[1:-1].max():.1e}")
        return float(found.mean_time[0])

    def loop() -> float:
        return dynamics.escape(system, params={"a": values[0]}, **ABOUT).mean_time

    def check(results: dict[str, float]) -> None:
        np.testing.assert_allclose(*results.values(), rtol=AGREEMENT)

    timings = take_turns({"jaxcell, exit_times": together, "jaxcell, escape": loop}, repeats, check)
    parts = zip(timings.items(), (MEMBERS, 1), strict=True)
    each = {name: Timing(*(one / count for one in timing)) for (name, timing), count in parts}
    table(f"Mean exit time per member, {CELLS**2:,} cells", each)
    return rows_of("exits", "mean exit time per member", f"{CELLS**2:,}", each)


def main() -> None:
    arguments = options(__doc__, repeats=1).parse_args()
    jax.config.update("jax_enable_x64", True)
    begin("jax", "numpy", "scipy")
    write_rows(arguments.rows, exits(arguments.repeats))


if __name__ == "__main__":
    main()
