"""By how much a bump turns a robot: bounces of a Create 2 in a physics engine.

    python -m experiments.chapter_2.physics_bounces

The model of section 2.3 of Alam 2018 turns a robot by its bouncing angle and by nothing else. A
real one is turned by the bump, too, until its wheels stand still. A Create 2 in MuJoCo, with its
driver, runs at a wall `--bounces` times, at incidences up to 85 degrees to either side. It turns by
45, 90 or 135 degrees, with or without backing up by 2 cm first, for two frictions of the floor,
three of the wall and three speeds. Written for each bounce:

- `gained`: the turn of the body by the bump, toward the wall, in degrees, and how much of it the
  encoders have `seen`;
- `error`: the error of the turn by the bouncing angle that follows;
- `late`: how much farther than to the wall the robot went by its encoders until it stood, in mm,
  and how far `aside` along the wall it stands;
- all are missing where the bump was not felt within 0.5 m.

Springs, switches, latency and acceleration are assumed as well. The second table varies each by
itself, at 0.2 m/s. The third has ten measurements that tell a robot's true numbers, with what is
expected of each, and the least and the most over all assumptions of the second table.

Writes `bounces.nc`, `bounces.csv`, `assumptions.csv`, `protocol.csv` and `bounces.png`.
"""

import argparse
import dataclasses
import itertools
import os
from pathlib import Path

import numpy as np
import xarray as xr

from jaxcell.record import save_dataset
from jaxcell.robot.physics import Physics

from ..shared.report import Rows, emit
from .bounce_batches import Bounce, batch


FLOORS, WALLS, SPEEDS = (0.5, 0.8), (0.1, 0.3, 0.5), (0.1, 0.2, 0.4)
TURNS, BACKS = (45.0, 90.0, 135.0), (0.0, 0.02)
INCIDENCES = (0, 15, 30, 45, 60, 75, 85)
UNITS = {"gained": "deg", "seen": "deg", "error": "deg", "late": "mm", "aside": "mm"}
WORDS = {
    "gained": "turn of the body by the bump, toward the wall",
    "seen": "turn by the bump, toward the wall, that the encoders show",
    "error": "error of the turn after the bump, counterclockwise",
    "late": "distance by the encoders from the wall to where the robot stood",
    "aside": "place along the wall where the robot stood",
}
# One by one, at 0.2 m/s: the least and the most that a real robot may have.
ASSUMED: dict[str, tuple[dict[str, float], ...]] = {
    "as assumed": ({},),
    "floor friction 0.4, 1.0": ({"floor": 0.4}, {"floor": 1.0}),
    "wall friction 0.1, 0.6": ({"wall": 0.1}, {"wall": 0.6}),
    "stiffness 250, 1000 N/m": ({"stiffness": 250.0}, {"stiffness": 1000.0}),
    "threshold 2, 3 mm": ({"threshold": 0.002}, {"threshold": 0.003}),
    "acceleration 0.9, 3.6 m/s²": ({"acceleration": 0.9}, {"acceleration": 3.6}),
    "latency 0, 30 ms": ({"latency": 0.0}, {"latency": 0.03}),
}
# Incidence in degrees, speed, backing up, and what is measured; the turn is by 135 degrees.
PROTOCOL = (
    (0, 0.2, 0.0, "gained"),
    (30, 0.2, 0.0, "gained"),
    (45, 0.2, 0.0, "gained"),
    (60, 0.2, 0.0, "gained"),
    (75, 0.2, 0.0, "gained"),
    (45, 0.1, 0.0, "gained"),
    (45, 0.4, 0.0, "gained"),
    (0, 0.2, 0.0, "error"),
    (0, 0.2, 0.02, "error"),
    (85, 0.2, 0.0, "late"),
)


def bounce(
    incidence: float,
    speed: float,
    back: float,
    turn: float = 135.0,
    phase: float = 0.0,
    **assumed: float,
) -> Bounce:
    latency = {"latency": assumed.pop("latency")} if "latency" in assumed else {}
    return Bounce(incidence, turn, speed, back, Physics(**assumed), phase=phase, **latency)


def statistics(count: int, processes: int) -> xr.Dataset:
    rng = np.random.default_rng(0)
    cases = list(itertools.product(FLOORS, WALLS, SPEEDS, TURNS, BACKS))
    drawn = [cases[index % len(cases)] for index in range(count)]
    incidence = rng.choice([-1, 1], count) * rng.choice(INCIDENCES, count).astype(float)
    phases = rng.uniform(size=count)
    bounces = [
        bounce(i, speed, back, turn, phase, floor=floor, wall=wall)
        for (floor, wall, speed, turn, back), i, phase in zip(
            drawn, incidence.tolist(), phases.tolist(), strict=True
        )
    ]
    about = np.array(drawn).T
    coords = {
        "floor": ("bounce", about[0], {"long_name": "friction of the floor"}),
        "wall": ("bounce", about[1], {"long_name": "friction of the wall"}),
        "speed": ("bounce", about[2], {"units": "m s-1"}),
        "turn": ("bounce", about[3], {"units": "deg", "long_name": "bouncing angle"}),
        "back": ("bounce", about[4], {"units": "m", "long_name": "way back before the turn"}),
        "incidence": ("bounce", incidence, {"units": "deg"}),
    }
    return xr.Dataset(
        {
            name: ("bounce", values, {"units": UNITS[name], "long_name": WORDS[name]})
            for name, values in batch(bounces, processes).items()
        },
        coords=coords,
        attrs={"title": "Bounces of a Create 2 in MuJoCo", "seed": 0},
    )


def rows(found: xr.Dataset) -> Rows:
    table: Rows = []
    steep = np.abs(found.incidence)
    for speed, wall in itertools.product(SPEEDS, WALLS):
        for incidence in INCIDENCES:
            some = (found.speed == speed) & (found.wall == wall) & (steep == incidence)
            one = found.isel(bounce=np.flatnonzero(some))
            if not one.bounce.size:
                continue
            stands = one.isel(bounce=np.flatnonzero(one.back == 0))
            backed = one.isel(bounce=np.flatnonzero(one.back > 0))
            table.append(
                {
                    "speed, wall": f"{speed:g} m/s, {wall:g}",
                    "incidence, deg": str(incidence),
                    "bounces": one.bounce.size,
                    "not felt, %": 100 * float(np.isnan(one.gained).mean()),
                    "turn by, the bump": float(one.gained.mean()),
                    "spread": float(one.gained.std()),
                    "unseen": float((one.gained - one.seen).mean()),
                    "error of the, turn": float(abs(stands.error).mean()),
                    "after, backing": float(abs(backed.error).mean()),
                    "late, mm": float(one.late.mean()),
                    "its, spread": float(one.late.std()),
                }
            )
    return table


def measured(
    jobs: list[tuple[float, float, float, str, dict[str, float]]], phases: int, processes: int
) -> np.ndarray:
    """The mean and the standard deviation of each measurement over the phases of the time slot."""
    bounces = [
        bounce(incidence, speed, back, phase=phase / phases, **assumed)
        for incidence, speed, back, _, assumed in jobs
        for phase in range(phases)
    ]
    found = batch(bounces, processes)
    every = [found[name].reshape(-1, phases)[job] for job, (*_, name, _) in enumerate(jobs)]
    return np.array([[np.nanmean(one), np.nanstd(one)] for one in every])


def assumptions(phases: int, processes: int) -> tuple[Rows, Rows]:
    variants = [(name, values) for name, some in ASSUMED.items() for values in some]
    jobs = [(*job, values) for _, values in variants for job in PROTOCOL]
    found = measured(jobs, phases, processes).reshape(len(variants), len(PROTOCOL), 2)
    names = [name for name, _ in variants]
    table: Rows = []
    for name in ASSUMED:
        some = found[[index for index, one in enumerate(names) if one == name], :, 0]
        shown = [" to ".join(f"{value:.1f}" for value in column) for column in some.T.tolist()]
        labels = [str(number) for number in range(1, len(PROTOCOL) + 1)]
        table.append({"varied": name, **dict(zip(labels, shown, strict=True))})
    protocol: Rows = []
    for number, (incidence, speed, back, name) in enumerate(PROTOCOL):
        mean, spread = found[0, number].tolist()
        protocol.append(
            {
                "measurement": str(number + 1),
                "incidence, deg": str(incidence),
                "speed, m/s": speed,
                "back, cm": 100 * back,
                "what": f"{name}, {UNITS[name]}",
                "expected": _rounded(mean),
                "spread": _rounded(spread),
                "least": _rounded(np.nanmin(found[:, number, 0])),
                "most": _rounded(np.nanmax(found[:, number, 0])),
            }
        )
    return table, protocol


def _rounded(value: float) -> float:
    # A zero without a sign.
    return round(float(value), 2) + 0.0


def draw(found: xr.Dataset, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(11, 4), layout="constrained", sharey=True)
    colors, marks = ("#0072b2", "#d55e00", "#009e73"), "osD"
    steep = np.abs(found.incidence)
    for panel, speed in zip(panels, SPEEDS, strict=True):
        for wall, color, mark in zip(WALLS, colors, marks, strict=True):
            means, spreads = [], []
            for incidence in INCIDENCES:
                some = (found.speed == speed) & (found.wall == wall) & (steep == incidence)
                means.append(float(found.gained[some].mean()))
                spreads.append(float(found.gained[some].std()))
            style = {"color": color, "marker": mark, "markersize": 5, "capsize": 3}
            panel.errorbar(
                INCIDENCES, means, spreads, label=f"friction of the wall {wall}", **style
            )
        panel.set_title(f"{speed} m/s", fontsize=10)
        panel.set_xlabel("incidence, degrees (0: head-on)")
        panel.grid(color="0.9")
    panels[0].set_ylabel("turn toward the wall by the bump, degrees")
    panels[0].legend(frameon=False, fontsize=8, loc="upper left")
    figure.savefig(path, dpi=150)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/chapter_2/physics_bounces"))
    parser.add_argument("--bounces", type=int, default=8000)
    parser.add_argument("--phases", type=int, default=20, help="bounces of each measurement")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    found = statistics(options.bounces, options.processes)
    found.attrs["physics"] = str(dataclasses.asdict(Physics()))
    save_dataset(found, options.out / "bounces.nc")
    draw(found, options.out / "bounces.png")
    emit("Bounces, in degrees", rows(found), options.out / "bounces.csv", spec=".2f")
    table, protocol = assumptions(options.phases, options.processes)
    emit("The ten measurements under other assumptions", table, options.out / "assumptions.csv")
    emit("Ten measurements on a real robot", protocol, options.out / "protocol.csv", spec=".2f")
    print(f"Data and figure in {options.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
