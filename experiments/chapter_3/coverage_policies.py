"""Table 3.1 of Alam 2018: shares of time of bouncing angles, and robots that switch by them.

    python -m experiments.chapter_3.coverage_policies

Robots with bouncing angles 30, 75 and 315 deg, an error of 5 deg and reliability 0.8 are to cover a
room of 183 positions in 360 directions (N = 65,880) evenly. The source shows its room as a picture
only. Ours, `data/maps/complex.json`, is another room, so the numbers cannot be compared.

Section 3.4.3 interprets the mixture as switching by time, which the second part simulates. Robots
with noisy turns repeat cycles in which each angle has its share of the steps. Total variation
compares the share of time that a single robot spends in each position with the predicted coverage.
It is the share of time that is in the wrong place. After a switch, a robot is not yet in a
persistent group of its new angle, which the prediction neglects. With cycles of constant length a
distance therefore remains, which is computed from distributions without simulation. With growing
cycles the distance tends to 0.

The script writes `coverage.nc` and `coverage.png`.
"""

import functools
import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

import jaxcell
from jaxcell.base.limits import Collision
from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import coverage_policy, noisy_bounce_map
from jaxcell.mapping.generalized import Chain
from jaxcell.space import CellSpace, Motion, Workspace

from ..shared.data import MAPS
from ..shared.figures import draw_room, plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import show, tracked


MAP = MAPS / "complex.json"
DIRECTIONS = 360
BOUNCES_DEG = (30, 75, 315)
ERROR_DEG = 5
RELIABILITY = 0.8
# Table 3.1 of Alam 2018, for another room.
TABLE_3_1 = (0.22138172, 0.28005791, 0.49856037)
COLLISIONS: tuple[Collision, ...] = ("swept", "endpoint")

CYCLES = {"100": 100, "1,000": 1000, "10,000": 10_000}
GROWING = "1,000, 2,000, 3,000, ..."
# The number of steps in a call of the simulation.
CHUNK = 1 << 14


# Switching by time.


def shares(alpha: np.ndarray, length: int) -> np.ndarray:
    """Compute the number of steps of each angle in a cycle; they add up to `length`."""
    ends = np.round(np.cumsum(alpha) * length).astype(int)
    return np.diff(ends, prepend=0)


def schedule(alpha: np.ndarray, name: str, steps: int) -> np.ndarray:
    """List the number of the angle in use at each step."""
    if name == GROWING:
        lengths: Iterator[int] = itertools.count(1000, 1000)
    else:
        lengths = itertools.repeat(CYCLES[name])
    used, done = [], 0
    while done < steps:
        length = next(lengths)
        used.append(np.repeat(np.arange(alpha.size, dtype=np.int32), shares(alpha, length)))
        done += length
    return np.concatenate(used)[:steps]


@functools.partial(jax.jit, static_argnames="positions")
def walk(
    policies: Chain,
    cell: jax.Array,
    visits: jax.Array,
    used: jax.Array,
    key: jax.Array,
    *,
    positions: int,
) -> tuple[jax.Array, jax.Array]:
    """Move robots for some steps, and count their visits.

    **Arguments:**

    - `policies`: the chains of all angles, stacked.
    - `cell`: the cell of each robot.
    - `visits`: the number of visits, `[robots, positions]`.
    - `used`: the number of the angle in use at each step.
    """
    robot = jnp.arange(cell.size)

    def step(state, now):
        cell, visits = state
        policy, draw = now
        probability = policies.probability[policy, :, cell]
        slot = jnp.sum(draw[:, None] >= jnp.cumsum(probability, axis=1), axis=1)
        slot = jnp.minimum(slot, probability.shape[1] - 1)
        cell = policies.image[policy, slot, cell]
        return (cell, visits.at[robot, cell % positions].add(1)), None

    draws = jax.random.uniform(key, (used.size, cell.size))
    return jax.lax.scan(step, (cell, visits), (used, draws))[0]


def simulate(
    policies: list[Chain],
    cells: CellSpace,
    used: np.ndarray,
    checks: np.ndarray,
    seed: int,
    robots: int,
) -> Iterator[np.ndarray]:
    """Yield the share of time `[robots, positions]` until each of the steps `checks`."""
    stacked = jax.tree.map(lambda *one: jnp.stack(one), *policies)
    start, key = jax.random.split(jax.random.key(seed))
    cell = jax.random.randint(start, (robots,), 0, cells.size, jnp.int32)
    visits = jnp.zeros((robots, cells.positions), jnp.int32)
    done = 0
    for check in checks.tolist():
        while done < check:
            part = used[done : min(done + CHUNK, check)]
            key, draw = jax.random.split(key)
            cell, visits = walk(
                stacked, cell, visits, jnp.asarray(part), draw, positions=cells.positions
            )
            done += part.size
        yield np.asarray(visits) / check


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Compute the total variation between distributions over the last axis."""
    return np.abs(one - other).sum(axis=-1) / 2


def coverage_of_cycles(policies: list[Chain], cells: CellSpace, steps: np.ndarray) -> np.ndarray:
    """Compute the long-run coverage of a robot that repeats a cycle, without simulation."""
    forwards = [one.to_scipy().T.tocsr() for one in policies]
    p = np.full(cells.size, 1 / cells.size)
    average = np.zeros(cells.positions)
    while True:
        total = np.zeros(cells.size)
        for forward, count in zip(forwards, steps.tolist(), strict=True):
            for _ in range(count):
                p = forward @ p
                total += p
        before, average = average, total.reshape(cells.directions, -1).sum(axis=0) / steps.sum()
        if apart(before, average) < 1e-6:
            return average


def study(steps: int, robots: int, seed: int) -> tuple[xr.Dataset, float]:
    """Compute the policies and simulate the robots; also return the seconds of one policy."""
    cells = CellSpace.of(Workspace.load(MAP), 1.0, DIRECTIONS)
    angles, error = np.radians(BOUNCES_DEG), math.radians(ERROR_DEG)
    policies, seconds = {}, math.inf
    for collision in COLLISIONS:
        motion = Motion(collision=collision)
        # The first call compiles.
        for _ in range(2):
            began = time.perf_counter()
            policies[collision] = coverage_policy(cells, angles, error, RELIABILITY, motion=motion)
            seconds = min(seconds, time.perf_counter() - began)
    swept = policies["swept"]
    alpha, predicted = np.asarray(swept.alpha), np.asarray(swept.mixture)
    noisy = [noisy_bounce_map(cells, angle, error, RELIABILITY) for angle in angles.tolist()]
    checks = np.unique(np.round(np.geomspace(100, steps, 25)).astype(int))
    distance = np.zeros((len(CYCLES) + 1, checks.size, robots))
    stays = np.zeros(len(CYCLES) + 1)
    visited = np.zeros((len(CYCLES) + 1, cells.positions))
    for i, name in enumerate(tracked((*CYCLES, GROWING), "kinds of cycles")):
        used = schedule(alpha, name, steps)
        for j, share in enumerate(simulate(noisy, cells, used, checks, seed + i, robots)):
            distance[i, j] = apart(share, predicted)
            visited[i] = share.mean(axis=0)
        if name != GROWING:
            cycle = coverage_of_cycles(noisy, cells, shares(alpha, CYCLES[name]))
            stays[i] = apart(cycle, predicted)
    x, y, _ = cells.centre(np.arange(cells.positions))
    time_share = {"long_name": "share of time", "units": "1"}
    total_variation = {"long_name": "total variation between visits and prediction"}
    by_angle, each = ("collision", "bounce_deg"), policies.values()
    results = xr.Dataset(
        {
            "alpha": (by_angle, [np.asarray(p.alpha) for p in each]),
            "table_3_1": ("bounce_deg", list(TABLE_3_1), {"long_name": "alpha of the source"}),
            "coverage": (
                (*by_angle, "position"),
                [np.asarray(p.coverage) for p in each],
                time_share,
            ),
            "mixture": (
                ("collision", "position"),
                [np.asarray(p.mixture) for p in each],
                time_share,
            ),
            "total_variation": ("collision", [p.total_variation for p in each]),
            "groups": (by_angle, [[g.count for g in p.groups] for p in each]),
            "persistent_cells": (by_angle, [[int(g.size.sum()) for g in p.groups] for p in each]),
            "residual": (by_angle, [[x.certificate.residual for x in p.limiting] for p in each]),
            "distance": (("cycle", "step", "robot"), distance, total_variation),
            "distance_that_stays": ("cycle", stays, {"long_name": "computed, not simulated"}),
            "visits": (("cycle", "position"), visited, time_share),
        },
        {
            "collision": list(COLLISIONS),
            "bounce_deg": list(BOUNCES_DEG),
            "cycle": [*CYCLES, GROWING],
            "step": checks,
            "x": ("position", x, {"units": "m"}),
            "y": ("position", y, {"units": "m"}),
        },
        {
            "title": "Coverage by a mixture of bouncing policies",
            "source": "jaxcell; after Alam 2018, section 3.5.3 and Table 3.1; own map",
            "jaxcell_version": jaxcell.__version__,
            "jax_version": jax.__version__,
            "map": MAP.name,
            "directions": DIRECTIONS,
            "error_deg": ERROR_DEG,
            "reliability": RELIABILITY,
            "seed": seed,
        },
    )
    return results, seconds


def report(results: xr.Dataset, seconds: float) -> None:
    """Print the shares of time, and the distances of robots from the prediction."""
    rows = []
    for angle in BOUNCES_DEG:
        here = results.sel(bounce_deg=angle)
        row = {"angle": f"{angle}°", "Table 3.1, another room": float(here.table_3_1)}
        for collision in COLLISIONS:
            row[f"here, {collision}"] = float(here.alpha.sel(collision=collision))
            cells = int(here.persistent_cells.sel(collision=collision))
            row[f"persistent, cells, {collision}"] = f"{cells:,}"
        rows.append(row)
    show("Share of time of each bouncing angle, even target", rows, ".8f")
    print(f"Persistent groups of an angle: at most {int(results.groups.max())}.")
    print(
        "The source shows its room as a picture only, and ours is another room, so the columns "
        "need not agree.\nIn section 3.5.3, 315 deg has about half of the time, and the others a "
        "quarter each."
    )
    distances = ", ".join(f"{float(v):.3f}" for v in results.total_variation)
    print(f"Total variation of the mixture from the even target: {distances}.")
    print(
        f"Stationarity residuals up to {float(results.residual.max()):.1e} (1-norm). A policy "
        f"takes {seconds:.3f} s after compilation.\n"
    )
    checks = results.step.values[[0, len(results.step) // 3, 2 * len(results.step) // 3, -1]]
    rows = []
    for name in results.cycle.values.tolist():
        row = results.sel(cycle=name)
        middle = row.distance.sel(step=checks).median("robot").values.tolist()
        headings = [f"after {check:,} steps" for check in checks]
        rows.append({"steps of a cycle": name, **dict(zip(headings, middle, strict=True))})
        rows[-1]["limit"] = float(row.distance_that_stays)
    show("Total variation between single robots and the prediction, medians", rows)


def draw(results: xr.Dataset, path: Path) -> None:
    """Draw coverages on the room, and the distances of robots over time."""
    from matplotlib.colors import LogNorm

    cells = CellSpace.of(Workspace.load(MAP), 1.0, DIRECTIONS)
    figure = plt.figure(figsize=(10, 6.6), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[1, 1.35])
    swept = results.sel(collision="swept")
    pictures = [
        *(
            (f"{a}° ± {ERROR_DEG}°, share {float(swept.alpha.sel(bounce_deg=a)):.3f}", c)
            for a, c in zip(BOUNCES_DEG, swept.coverage.values, strict=True)
        ),
        ("the mixture", swept.mixture.values),
        ("visited, growing cycles", results.visits.sel(cycle=GROWING).values),
    ]
    panels = top.subplots(1, len(pictures))
    for axes, (title, values) in zip(panels, pictures, strict=True):
        image = np.full(cells.free.shape, np.nan)
        image[cells.free] = values * cells.positions
        draw_room(axes, cells.free)
        shown = axes.imshow(
            np.where(image > 0, image, np.nan),
            origin="lower",
            extent=(0, image.shape[1], 0, image.shape[0]),
            cmap="viridis",
            norm=LogNorm(1 / 16, 16),
        )
        axes.set_title(title, fontsize=7.5)
    bar = top.colorbar(shown, ax=panels, location="bottom", shrink=0.4, aspect=40, extend="both")
    bar.set_label("time in a position, relative to an even share (white: never)", fontsize=8)
    axes = bottom.subplots()
    colors = ["#e69f00", "#56b4e9", "#cc79a7", "#009e73"]
    for name, color in zip(results.cycle.values, colors, strict=True):
        row = results.sel(cycle=name)
        low, middle, high = row.distance.quantile([0.1, 0.5, 0.9], "robot").values
        axes.fill_between(results.step, low, high, color=color, alpha=0.2, linewidth=0)
        axes.plot(results.step, middle, color=color, label=f"cycles of {name} steps")
        if name != GROWING:
            axes.axhline(float(row.distance_that_stays), color=color, linestyle=":", linewidth=1)
    axes.set(xscale="log", yscale="log", xlabel="steps", ylabel="total variation")
    axes.set_title(
        f"Visits of each of {results.sizes['robot']} robots against the predicted coverage "
        "(median, 10 to 90 %; dotted: computed limit)",
        fontsize=9,
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    save(figure, path)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_3/coverage_policies", seed=0)
    parser.add_argument("--steps", type=at_least(1000), default=300_000, help="steps of each robot")
    parser.add_argument("--robots", type=at_least(1), default=32, help="number of robots")
    options = read_options(parser)

    configure_jax()
    began = time.perf_counter()
    results, seconds = study(options.steps, options.robots, options.seed)
    report(results, seconds)
    results.to_netcdf(options.out / "coverage.nc")
    draw(results, options.out / "coverage.png")
    print(f"{time.perf_counter() - began:.0f} s in all; data and figure in {options.out}")


if __name__ == "__main__":
    main()
