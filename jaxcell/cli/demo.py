import dataclasses
import time
from pathlib import Path
from typing import Any

from ..base.bundled import bundled
from .studies import Cover, Drift, Localize, Navigate, PatrolMap, Team
from .terminal import note, note_results


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo:
    """Tour localization, navigation, coverage, patrolling and drifters on bundled data."""

    out: Path = Path("runs/demo")
    """Directory for the results, a folder for each stop of the tour."""

    def run(self) -> int:
        stops = tour(self.out)
        began = time.perf_counter()
        for number, (title, command) in enumerate(stops, start=1):
            note(f"\n{number}/{len(stops)} {title}")
            status = command.run()
            if status != 0:
                return int(status)
        seconds = time.perf_counter() - began
        note(
            f"\n{len(stops)} stops in {seconds:.0f} s. Each has a folder in {self.out}, with a "
            "Rerun recording, NetCDF files and summary.json."
        )
        note_results(self.out)
        return 0


def tour(out: Path) -> list[tuple[str, Any]]:
    """The stops of the demo: what is shown, and the command that shows it."""
    lab, room = bundled("maps/lab_a.json"), bundled("maps/complex.json")
    return [
        (
            "A robot with a bump sensor and a clock finds out where it is (chapter 2)",
            Localize(map=lab, collision="endpoint", bounce=135.0, out=out / "localize"),
        ),
        (
            "With another bouncing angle it ends in one of three knowledge cycles",
            Localize(map=lab, collision="endpoint", bounce=45.0, out=out / "localize_45"),
        ),
        (
            "It chooses an angle at each bump to get from one pose to another (chapter 3)",
            Navigate(
                map=room,
                directions=8,
                bounces=(45.0, 90.0, 135.0),
                start="0.5,1.5,0",
                goal="12.5,9.5,0",
                out=out / "navigate",
            ),
        ),
        (
            "It divides its time among imprecise bounces to cover a room",
            Cover(
                map=room,
                bounces=(30.0, 75.0, 315.0),
                error=5.0,
                reliability=0.8,
                out=out / "cover",
            ),
        ),
        (
            "Four robots cover a room together",
            Team(map=room, robots=4, bounce=(135.0,), out=out / "team"),
        ),
        (
            "Two robots that see 6 m patrol a depot against an adversary (chapter 4)",
            PatrolMap(map=bundled("maps/depot.json"), robots=2, range=6.0, out=out / "patrol"),
        ),
        (
            "Where a current carries drifters, and how to steer one by its depth (chapter 5)",
            Drift(
                file=(bundled("ocean/gyres.nc"),),
                start="-117.93,33.5",
                goal="-118.1,33.45,5",
                out=out / "drift",
            ),
        ),
    ]
