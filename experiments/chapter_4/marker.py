"""Measure the detection of the marker of a dummy intruder (Alam 2018, section 4.5.7).

    python -m experiments.chapter_4.marker

In the source, robots find a cross in the frames of their cameras; it has no rates of detection.
Here frames of 640 by 480 pixels are drawn: a room full of clutter with the marker somewhere in it.
All conditions are random except one, which is fixed at each of several values. The marker is found
if the error of its centre is less than a tenth of its size. False alarms are counted in frames with
clutter alone, and in frames with sheets that show another sign. All intervals are exact
(Clopper and Pearson) intervals of 95%.

The script writes `marker.nc`, `detection.csv`, `false_alarms.csv` and `marker.png`. The exit status
is 1 if the interval for random conditions is below 97% of markers found, or if the interval for
clutter alone is above 0.5% false alarms.
"""

import dataclasses
import functools
import math
import multiprocessing
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxcell.robot.marker import find_cross

from ..shared.figures import plt, save
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit, interval, say, tracked


sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
import marker_frames


ORDINARY = marker_frames.Conditions()
LEAST_FOUND, MOST_ALARMS = 0.97, 0.005
# Each condition: its name with its unit, this unit in the units of the field, and its values.
FACTORS: dict[str, tuple[str, float, tuple[float, ...]]] = {
    "span": ("size (px)", 1, (16, 20, 24, 32, 64, 128, 192)),
    "noise": ("noise (grey levels)", 1, (0, 10, 20, 30, 40, 60)),
    "rotation": ("rotation (deg)", math.pi / 180, (0, 15, 30, 45, 60, 75)),
    "tilt": ("tilt (deg)", math.pi / 180, (0, 15, 30, 45, 60, 70)),
    "light": ("light (1 is full)", 1, (0.03, 0.06, 0.12, 0.25, 0.5, 1)),
    "glare": ("glare (1 is full)", 1, (0, 0.3, 0.6, 0.9)),
    "blur": ("blur (px)", 1, (0, 1, 2, 3, 4)),
    "hidden": ("hidden part of it", 1, (0, 0.03, 0.1, 0.2, 0.3)),
}


@dataclasses.dataclass(frozen=True)
class Scene:
    """Conditions of frames with a marker, with another sign, or with neither."""

    factor: str
    value: float
    conditions: marker_frames.Conditions
    marker: bool = True
    sign: str | None = None


def scenes() -> list[Scene]:
    found = [Scene("all random", math.nan, ORDINARY)]
    for factor, (_, unit, values) in FACTORS.items():
        for value in values:
            held: Any = {factor: (value * unit, value * unit)}
            found.append(Scene(factor, value, dataclasses.replace(ORDINARY, **held)))
    return found


def other_scenes() -> list[Scene]:
    signs = [None, *marker_frames.SIGNS]
    return [Scene("", math.nan, ORDINARY, marker=False, sign=sign) for sign in signs]


def look(seed: int, job: tuple[int, Scene, int]) -> tuple[int, bool, bool, float, float, float]:
    """Draw a frame, and search for the marker in it.

    Returns the number of the scene, `True` if the marker was found, `True` for a false alarm, the
    error of the centre in pixels, the score, and the seconds of the processor.
    """
    number, scene, frame = job
    rng = np.random.default_rng((seed, number, frame))
    if scene.marker:
        seen = marker_frames.with_marker(rng, scene.conditions)
        shown, place, near = seen.frame, seen.centre, 0.1 * np.ptp(seen.corners, axis=0).max()
    else:
        shown = marker_frames.without_marker(rng, scene.conditions, sign=scene.sign)
        place, near = np.full(2, math.inf), 0.0
    began = time.process_time()
    cross = find_cross(shown)
    seconds = time.process_time() - began
    if cross is None:
        return number, False, False, math.nan, math.nan, seconds
    off = math.dist(cross.centre, place)
    right = bool(off < near)
    return number, right, not right, off if right else math.nan, cross.score, seconds


def one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def study(jobs: list[tuple[int, Scene, int]], seed: int, workers: int) -> Iterator[Any]:
    """Run the jobs in several processes, and yield their results in any order."""
    with multiprocessing.get_context("spawn").Pool(workers, one_thread) as pool:
        results = pool.imap_unordered(functools.partial(look, seed), jobs, chunksize=8)
        yield from tracked(results, "frames", len(jobs))


def summary(all_scenes: list[Scene], results: list[Any]) -> xr.Dataset:
    """Compute the rates of all scenes."""
    kept = []
    for number, scene in enumerate(all_scenes):
        mine = [one[1:] for one in results if one[0] == number]
        found, alarms, off, _, _ = (np.array(column) for column in zip(*mine, strict=True))
        count = int(found.sum() if scene.marker else alarms.sum())
        low, high = interval(count, len(mine), "exact")
        kept.append(
            {
                "frames": len(mine),
                "found": int(found.sum()),
                "alarms": int(alarms.sum()),
                "rate": count / len(mine),
                "low": low,
                "high": high,
                "off": float(np.nanmedian(off)) if found.any() else math.nan,
                "off_95": float(np.nanquantile(off, 0.95)) if found.any() else math.nan,
            }
        )
    data = xr.Dataset({name: ("scene", [one[name] for one in kept]) for name in kept[0]})
    data["rate"].attrs["long_name"] = "share of frames with the marker found, or with a false alarm"
    for name in ("off", "off_95"):
        data[name].attrs["units"] = "pixel"
    return data.assign_coords(
        factor=("scene", [scene.factor for scene in all_scenes]),
        value=("scene", [scene.value for scene in all_scenes]),
        marker=("scene", [scene.marker for scene in all_scenes]),
        sign=("scene", [scene.sign or "" for scene in all_scenes]),
    )


def report(data: xr.Dataset, out: Path) -> bool:
    """Print the rates; returns `True` if they satisfy the limits."""
    detection: Rows = []
    alarms: Rows = []
    for k in range(data.sizes["scene"]):
        row = {name: data[name].values[k].item() for name in data.variables}
        rates = {"rate": row["rate"], "from": row["low"], "to": row["high"]}
        if row["marker"]:
            factor = row["factor"]
            name = FACTORS[factor][0] if factor in FACTORS else factor
            value = "" if math.isnan(row["value"]) else f"{row['value']:g}"
            detection.append(
                {"held": name, "at": value, "frames": row["frames"], "found": row["found"]}
                | rates
                | {"elsewhere": row["alarms"], "off, px": row["off"], "off 95%, px": row["off_95"]}
            )
        else:
            sign = row["sign"] or "clutter alone"
            alarms.append(
                {"sign": sign, "frames": row["frames"], "false alarms": row["alarms"]} | rates
            )
    emit("Frames in which the marker is found", detection, out / "detection.csv")
    emit("Frames without a marker that give an alarm", alarms, out / "false_alarms.csv", ".4f")
    clutter = alarms[0]
    signs = sum(row["false alarms"] for row in alarms[1:])
    frames = sum(row["frames"] for row in alarms[1:])
    low, high = interval(signs, frames, "exact")
    ordinary = detection[0]
    say(
        f"""If all conditions are random, the marker is found in {ordinary["found"]} of
        {ordinary["frames"]} frames ({ordinary["from"]:.1%} to {ordinary["to"]:.1%}). Clutter alone
        gives {clutter["false alarms"]} false alarms in {clutter["frames"]} frames
        ({clutter["from"]:.2%} to {clutter["to"]:.2%}). Clutter with one to six sheets of another
        sign gives {signs} in {frames} frames ({low:.2%} to {high:.2%}), with equally many frames
        per sign."""
    )
    return ordinary["to"] >= LEAST_FOUND and clutter["from"] <= MOST_ALARMS


def draw(data: xr.Dataset, path: Path, seed: int) -> None:
    """Draw four frames, and the rate of detection by each condition."""
    figure, panels = plt.subplots(3, 4, figsize=(14, 9), layout="constrained")
    rng = np.random.default_rng(seed)
    for axes, hidden in zip(panels[0], (0.0, 0.0, 0.0, 0.1), strict=True):
        conditions = dataclasses.replace(ORDINARY, hidden=(hidden, hidden), span=(60.0, 200.0))
        seen = marker_frames.with_marker(rng, conditions)
        axes.imshow(seen.frame, cmap="gray")
        cross = find_cross(seen.frame)
        if cross is not None:
            circle = plt.Circle(cross.centre, cross.arm, fill=False, color="tab:red", lw=1.5)
            axes.add_patch(circle)
        axes.set_axis_off()
        axes.set_title(f"found, {cross.score:.2f}" if cross else "not found", fontsize=10)
    for axes, (factor, (name, _, _)) in zip(panels[1:].flat, FACTORS.items(), strict=True):
        mine = data.isel(scene=data["factor"].values == factor)
        rate = mine["rate"].values
        spread = np.abs(np.stack([rate - mine["low"].values, mine["high"].values - rate]))
        axes.errorbar(mine["value"], rate, spread, fmt="o-", capsize=3)
        if factor in ("span", "light"):
            axes.set_xscale("log")
            axes.set_xticks(mine["value"].values, [f"{at:g}" for at in mine["value"].values])
            axes.minorticks_off()
        axes.set(xlabel=name, ylim=(-0.03, 1.03))
        axes.grid(alpha=0.3)
    for axes in panels[1:, 0]:
        axes.set_ylabel("found")
    figure.suptitle("Four drawn frames with the marker, and its rate of detection (95% intervals)")
    save(figure, path, dpi=120)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_4/marker", seed=0)
    parser.add_argument("--frames", type=at_least(1), default=100, help="frames per condition")
    parser.add_argument("--clutter", type=at_least(1), default=3000, help="frames of clutter alone")
    parser.add_argument("--workers", type=at_least(1), default=2, help="processes")
    options = read_options(parser)

    shown = [*scenes(), *other_scenes()]
    frames = [options.frames] * len(shown)
    frames[0] *= 3
    frames[len(scenes())] = options.clutter
    jobs = [
        (number, scene, frame)
        for number, (scene, count) in enumerate(zip(shown, frames, strict=True))
        for frame in range(count)
    ]
    # Results arrive in any order.
    results = sorted(study(jobs, options.seed, options.workers), key=lambda one: one[0])
    data = summary(shown, results)
    data.attrs.update(seed=options.seed, title=__doc__.splitlines()[0])
    data.to_netcdf(options.out / "marker.nc")
    draw(data, options.out / "marker.png", options.seed)
    good = report(data, options.out)
    seconds = np.array([one[5] for one in results])
    say(
        f"""On one thread, find_cross took a median of {1000 * np.median(seconds):.0f} ms of the
        processor, with a 99th percentile of {1000 * np.quantile(seconds, 0.99):.0f} ms."""
    )
    print(f"Data and figure in {options.out}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
