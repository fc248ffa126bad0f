import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from .. import study
from ..base.formatting import counted
from ..base.results import result_folder
from .output import write_text
from .startup import starting
from .study_command import command_of
from .terminal import note, note_results, stdout_on_stderr
from .words import parsed


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo:
    """Show homing, groups, localization, plans, coverage, patrols and drifters on bundled data."""

    example: ClassVar[str] = ""

    out: Path = Path("runs/demo")
    """Folder for the results, with a subfolder for each example."""

    def run(self) -> int:
        began, pages = time.perf_counter(), ["# What the tour shows"]
        with starting():
            from ..base.runtime import compile_quickly

            # The tour runs each program only once, so compilation must be fast.
            compile_quickly()
            from .. import record  # noqa: F401
        for number, stop in enumerate(STOPS, start=1):
            note(f"{number}/{len(STOPS)} {stop.title}\n    {stop.line}")
            command = parsed(command_of(stop.study), stop.study.command, stop.options.split())
            with stdout_on_stderr():
                result, summary = command.answer()
                sentences = stop.sentences(result)
                with result_folder(self.out / stop.folder) as folder:
                    command.write(result, summary, folder)
            note("".join(f"    {sentence}\n" for sentence in sentences))
            files = sorted(path.name for path in (self.out / stop.folder).iterdir())
            links = ", ".join(f"[{name}]({stop.folder}/{name})" for name in files)
            text = " ".join(sentences)
            pages += [f"## {stop.title}", f"    {stop.line}", text, f"Files: {links}"]
        index = self.out / "index.md"
        write_text(index, "\n\n".join(pages) + "\n")
        seconds = time.perf_counter() - began
        note(f"{len(STOPS)} answers in {seconds:.0f} s; {index} lists what to open.")
        note_results(self.out)
        return 0


@dataclasses.dataclass(frozen=True)
class Stop:
    folder: str
    title: str
    study: type[study.Study]
    options: str
    sentences: Callable[[Any], Sequence[str]]
    "A function that describes the result in sentences."

    @property
    def line(self) -> str:
        return f"jaxcell {self.study.command} {self.options}"


def _home(result: Any) -> list[str]:
    return [
        f"{result.arrived_share:.0%} of {result.robots} robots find out where they are and come "
        f"home, after {counted(result.median_bumps_until_home, 'bump')} in the median.",
        f"The filter loses {result.lost_share:.0%} of them, although runs, turns and the first "
        "heading are uncertain.",
    ]


def _groups(result: Any) -> list[str]:
    (count,), (short,), (long,) = result.count, result.shortest_period, result.longest_period
    (largest,), (away,) = result.largest_basin, result.longest_transient
    cells = result.cells.size
    return [
        f"All {cells:,} cells lead to {count} periodic groups, with periods of {short} to {long}.",
        f"The largest basin has {largest / cells:.0%} of the cells, and the longest transient "
        f"takes {counted(away, 'mapping')}.",
    ]


def _localized(result: Any) -> list[str]:
    return [
        f"From any of {result.cells.size} cells one is left after at most "
        f"{counted(result.worst_bumps, 'bump')}, {result.mean_bumps:.1f} in the mean.",
        "No choice of angles does it in fewer."
        if result.optimal
        else f"None does it in fewer than {result.least:g}.",
    ]


def _navigated(result: Any) -> list[str]:
    reach, cells = result.cells_that_reach_the_goal, result.cells.size
    return [
        f"{counted(result.steps, 'step')}, {counted(result.bumps, 'bump')}, another angle than "
        f"before at {result.changes} of them.",
        f"The goal is reached from {reach:,} of {cells:,} cells; from the others no plan exists.",
    ]


def _covered(result: Any) -> list[str]:
    import numpy as np

    shares = ", ".join(f"{share:.0%}" for share in np.asarray(result.alpha).tolist())
    apart = np.asarray(result.coverage) - np.asarray(result.target)
    alone = np.abs(apart).sum(axis=1).min() / 2
    return [
        f"Shares of time: {shares}.",
        f"Time spent elsewhere than wanted: {result.total_variation:.0%}; with the best angle "
        f"alone {alone:.0%}.",
    ]


def _team(result: Any) -> list[str]:
    return [
        f"Half of the {result.cells.positions} positions are visited after "
        f"{result.steps_to_50_percent:.0f} steps, all after {result.steps}.",
        f"Robots meet {result.collisions_in_all} times on the way.",
    ]


def _game(result: Any) -> list[str]:
    game = result.game
    shares = zip(game.strategy, game.share.tolist(), strict=True)
    mixed = ", ".join(f"{share:.0%} {name}" for name, share in shares if share > 1e-6)
    return [
        f"The best mixture of walks: {mixed}.",
        f"It pays the patroller {game.value:.2f}, the best walk alone {game.alone:.2f}.",
    ]


def _drifted(result: Any) -> list[str]:
    curve = result.curve_covered.tolist()
    few = [count for count in (1, 5, 20, 80) if count < len(curve)]
    rising = ", ".join(f"{curve[count - 1]} from {count}" for count in few)
    return [
        f"Drifters gather in {result.persistent_groups} groups of the {result.cells} cells, after "
        f"{result.median_hours:.1f} hours (median).",
        f"Cells that drifters visit: {rising}, and {curve[-1]} from {len(curve)}.",
    ]


STOPS = (
    Stop(
        "home",
        "A robot is put down anywhere and comes home by its bumps",
        study.NavigateAnywhere,
        "@complex --bounce 45 100 135 --goal 1,1 --heading unknown "
        "--errors run=2% distance=5cm turn=1deg --measured --robots 20 --bumps 25",
        _home,
    ),
    Stop(
        "groups",
        "Where a robot ends that turns by one angle at each wall",
        study.Groups,
        "@complex --bounce 90",
        _groups,
    ),
    Stop(
        "localize",
        "A robot with a bump sensor and a clock finds out where it is",
        study.Localize,
        "@lab_a --bounce 45 135",
        _localized,
    ),
    Stop(
        "navigate",
        "It chooses an angle at each bump to get to a goal",
        study.Navigate,
        "@complex --bounce 90 180 --start 0.5,1.5,0 --goal 15.5,12.5,90",
        _navigated,
    ),
    Stop(
        "cover",
        "It divides its time among imprecise bounces to cover a room evenly",
        study.Cover,
        "@complex --directions 72 --bounce 80 125 335 --errors turn=5deg --reliability 0.8",
        _covered,
    ),
    Stop(
        "team",
        "Four robots cover the room together",
        study.Team,
        "@complex --robots 4 --bounce 135",
        _team,
    ),
    Stop(
        "patrol",
        "A patroller mixes walks against an adversary who knows the mixture",
        study.PatrolGraph,
        "@eight --game",
        _game,
    ),
    Stop(
        "drift",
        "Where a current carries drifters, and where to drop them",
        study.Drift,
        "@gyres --depths 0 --duration 7200 --current mean",
        _drifted,
    ),
)
