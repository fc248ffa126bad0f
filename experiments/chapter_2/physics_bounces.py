"""Measure how far a bump turns a Create 2 in a physics engine.

    python -m experiments.chapter_2.physics_bounces

In the model of section 2.3 of Alam 2018 a robot turns by its bouncing angle and by nothing else. A
bump also turns a real robot, until its wheels stand still. Here a Create 2 in MuJoCo, with its
driver, runs into a wall `--bounces` times, at incidences up to 85 degrees to either side. It turns
by 45, 90 or 135 degrees, with or without backing up by 2 cm first, for two frictions of the floor,
three of the wall, and three speeds. The measurements of each bounce are

- `gained`: the turn of the body by the bump, toward the wall, in degrees; `seen`: the part of this
  turn that the encoders show;
- `error`: the error of the following turn by the bouncing angle;
- `late`: the distance that the encoders show beyond the wall until the robot stands, in mm;
  `aside`: its final distance along the wall.

All are missing if the robot does not notice the bump within 0.5 m.

Springs, switches, latency and acceleration are assumptions too. The second table varies one at a
time, at 0.2 m/s. The third table has ten measurements by which an owner can find the values of a
real robot: the expected value, and the least and largest over the assumptions of the second table.

The script writes `bounces.nc`, `bounces.csv`, `assumptions.csv`, `protocol.csv` and `bounces.png`.
"""

import dataclasses
import itertools
import os
from pathlib import Path

import numpy as np
import xarray as xr

from jaxcell.record import save_dataset
from jaxcell.robot.physics import Physics

from ..shared.figures import plt, save
from ..shared.options import at_least, experiment_parser, read_options
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
    "late": "distance by the encoders from the wall to the place where the robot stood",
    "aside": "place along the wall where the robot stood",
}
# The least and the largest value that a real robot may have, by the assumption that varies.
ASSUMED: dict[str, tuple[dict[str, float], ...]] = {
    "as assumed": ({},),
    "floor friction 0.4, 1.0": ({"floor": 0.4}, {"floor": 1.0}),
    "wall friction 0.1, 0.6": ({"wall": 0.1}, {"wall": 0.6}),
    "stiffness 250, 1000 N/m": ({"stiffness": 250.0}, {"stiffness": 1000.0}),
    "threshold 2, 3 mm": ({"threshold": 0.002}, {"threshold": 0.003}),
    "acceleration 0.9, 3.6 m/s²": ({"acceleration": 0.9}, {"acceleration": 3.6}),
    "latency 0, 30 ms": ({"latency": 0.0}, {"latency": 0.03}),
}
# Incidence in degrees, speed in m/s, metres to back up, and quantity; turns are 135 degrees.
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
    """Make the conditions of a bounce from the parameters of `Physics`, and `latency`."""
    latency = {"latency": assumed.pop("latency")} if "latency" in assumed else {}
    return Bounce(incidence, turn, speed, back, Physics(**assumed), phase=phase, **latency)


def statistics(count: int, processes: int) -> xr.Dataset:
    """Measure `count` bounces under all combinations of conditions."""
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


def chosen(measurements: xr.Dataset, speed: float, wall: float, incidence: float) -> xr.Dataset:
    """Select the bounces with these conditions, to either side."""
    same = (
        (measurements.speed == speed)
        & (measurements.wall == wall)
        & (abs(measurements.incidence) == incidence)
    )
    return measurements.isel(bounce=np.flatnonzero(same))


def rows(measurements: xr.Dataset) -> Rows:
    """Tabulate means over bounces by speed, friction of the wall, and incidence."""
    table: Rows = []
    for speed, wall, incidence in itertools.product(SPEEDS, WALLS, INCIDENCES):
        one = chosen(measurements, speed, wall, incidence)
        if not one.bounce.size:
            continue
        error = abs(one.error)
        table.append(
            {
                "speed, wall": f"{speed:g} m/s, {wall:g}",
                "incidence, deg": str(incidence),
                "bounces": one.bounce.size,
                "not felt, %": 100 * float(np.isnan(one.gained).mean()),
                "turn by, the bump": float(one.gained.mean()),
                "spread": float(one.gained.std()),
                "unseen": float((one.gained - one.seen).mean()),
                "error of the, turn": float(error[one.back.values == 0].mean()),
                "after, backing": float(error[one.back.values > 0].mean()),
                "late, mm": float(one.late.mean()),
                "its, spread": float(one.late.std()),
            }
        )
    return table


def measured(
    jobs: list[tuple[float, float, float, str, dict[str, float]]], phases: int, processes: int
) -> np.ndarray:
    """Compute the mean and the standard deviation of each measurement over phases of the time slot.

    The result is an array `[jobs, 2]`.
    """
    bounces = [
        bounce(incidence, speed, back, phase=phase / phases, **assumed)
        for incidence, speed, back, _, assumed in jobs
        for phase in range(phases)
    ]
    measurements = batch(bounces, processes)
    every = [measurements[name].reshape(-1, phases)[job] for job, (*_, name, _) in enumerate(jobs)]
    return np.array([[np.nanmean(one), np.nanstd(one)] for one in every])


def assumptions(phases: int, processes: int) -> tuple[Rows, Rows]:
    """Tabulate the measurements under all assumptions, and as a protocol for a real robot."""
    variants = [(name, values) for name, choices in ASSUMED.items() for values in choices]
    jobs = [(*job, values) for _, values in variants for job in PROTOCOL]
    measurements = measured(jobs, phases, processes).reshape(len(variants), len(PROTOCOL), 2)
    table: Rows = []
    for name in ASSUMED:
        means = measurements[[variant == name for variant, _ in variants], :, 0]
        shown = [" to ".join(f"{value:.1f}" for value in column) for column in means.T.tolist()]
        labels = [str(number) for number in range(1, len(PROTOCOL) + 1)]
        table.append({"varied": name, **dict(zip(labels, shown, strict=True))})
    protocol: Rows = []
    for number, (incidence, speed, back, name) in enumerate(PROTOCOL):
        mean, spread = measurements[0, number].tolist()
        protocol.append(
            {
                "measurement": str(number + 1),
                "incidence, deg": str(incidence),
                "speed, m/s": speed,
                "back, cm": 100 * back,
                "what": f"{name}, {UNITS[name]}",
                "expected": _rounded(mean),
                "spread": _rounded(spread),
                "least": _rounded(np.nanmin(measurements[:, number, 0])),
                "most": _rounded(np.nanmax(measurements[:, number, 0])),
            }
        )
    return table, protocol


def _rounded(value: float) -> float:
    # The sum turns -0.0 into 0.0.
    return round(float(value), 2) + 0.0


def draw(measurements: xr.Dataset, path: Path) -> None:
    """Draw the turn by the bump against the incidence."""
    figure, panels = plt.subplots(1, 3, figsize=(11, 4), layout="constrained", sharey=True)
    colors, marks = ("#0072b2", "#d55e00", "#009e73"), "osD"
    for panel, speed in zip(panels, SPEEDS, strict=True):
        for wall, color, mark in zip(WALLS, colors, marks, strict=True):
            gained = [
                chosen(measurements, speed, wall, incidence).gained for incidence in INCIDENCES
            ]
            means, spreads = [float(x.mean()) for x in gained], [float(x.std()) for x in gained]
            style = {"color": color, "marker": mark, "markersize": 5, "capsize": 3}
            label = f"friction of the wall {wall}"
            panel.errorbar(INCIDENCES, means, spreads, label=label, **style)
        panel.set_title(f"{speed} m/s", fontsize=10)
        panel.set_xlabel("incidence, degrees (0: head-on)")
        panel.grid(color="0.9")
    panels[0].set_ylabel("turn toward the wall by the bump, degrees")
    panels[0].legend(frameon=False, fontsize=8, loc="upper left")
    save(figure, path)


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/physics_bounces")
    parser.add_argument("--bounces", type=at_least(1), default=8000, help="number of bounces")
    parser.add_argument("--phases", type=at_least(1), default=20, help="bounces per measurement")
    parser.add_argument("--processes", type=at_least(1), default=os.cpu_count())
    options = read_options(parser)

    measurements = statistics(options.bounces, options.processes)
    measurements.attrs["physics"] = str(dataclasses.asdict(Physics()))
    save_dataset(measurements, options.out / "bounces.nc")
    draw(measurements, options.out / "bounces.png")
    emit("Bounces, in degrees", rows(measurements), options.out / "bounces.csv", spec=".2f")
    table, protocol = assumptions(options.phases, options.processes)
    emit("The ten measurements under other assumptions", table, options.out / "assumptions.csv")
    emit("Ten measurements on a real robot", protocol, options.out / "protocol.csv", spec=".2f")
    print(f"Data and figure in {options.out}")


if __name__ == "__main__":
    main()
