import dataclasses
from pathlib import Path

from .localize import FILES, Localize
from .terminal import note


_MAPS = Path(__file__).parents[2] / "data" / "maps"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo:
    """Localize a bouncing robot on three bundled maps, and leave results to look at."""

    out: Path = Path("runs/demo")
    """Directory for the results."""

    def run(self) -> int:
        if not _MAPS.is_dir():
            raise ValueError(
                f"{_MAPS}: the demo needs the maps of a checkout of jaxcell, which are not here"
            )
        lab, room = _MAPS / "lab_a.json", _MAPS / "room_200x125.json"
        tours = {
            "lab_a_45": Localize(
                map=lab, bounce=45, collision="endpoint", out=self.out / "lab_a_45"
            ),
            "lab_a_135": Localize(
                map=lab, bounce=135, collision="endpoint", out=self.out / "lab_a_135"
            ),
            "room": Localize(map=room, bounce=90, directions=8, out=self.out / "room"),
        }
        for tour in tours.values():
            tour.run()
        note(f"\nEach folder in {self.out} holds {', '.join(FILES)}.")
        return 0
