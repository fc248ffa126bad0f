import dataclasses
import json
from pathlib import Path
from typing import Any, ClassVar

from .. import space
from ..base.bundled import bundled_names
from .described import describe
from .output import Printing
from .terminal import say, table


# Size of a picture in characters; a character is twice as high as wide.
_WIDTH, _HEIGHT = 24, 6
_HALVES = " ▄▀█"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Maps(Printing):
    """List the maps, graphs, currents and sweeps that come with jaxcell. Any command accepts their
    names, which begin with @, in place of files."""

    example: ClassVar[str] = ""

    def run(self) -> int:
        described = {
            folder: {
                f"@{name}": describe(path)
                for name, path in bundled_names().items()
                if path.parent.name == folder
            }
            for folder in dict.fromkeys(path.parent.name for path in bundled_names().values())
        }
        if self.json:
            say(json.dumps(described))
            return 0
        table("Maps", ("name", "what it is", "picture"), map(_map, described.pop("maps").items()))
        rest = [
            (name, _line(fields)) for kind in described.values() for name, fields in kind.items()
        ]
        table("Graphs, currents and sweeps", ("name", "what it is"), rest)
        return 0


def _map(item: tuple[str, dict[str, Any]]) -> tuple[str, str, str]:
    name, fields = item
    text = (
        f"{fields['name']}\n{fields['width_m']:g} x {fields['height_m']:g} m\n"
        f"{fields['positions']:,} positions of {fields['cell_m']:g} m"
    )
    if fields["directions"]:
        text += f"\n{fields['directions']} directions"
    return name, text, picture(bundled_names()[name[1:]]) + "\n"


def _line(fields: dict[str, Any]) -> str:
    shown = (f"{value} {name}" for name, value in fields.items() if isinstance(value, int))
    return ", ".join([fields["what"], *shown])


def picture(path: Path) -> str:
    """Draw a map in characters, with a frame around it; free squares are blank."""
    import numpy as np

    free = space.CellSpace.load(path).free[::-1]
    rows, columns = free.shape
    scale = max(1.0, columns / _WIDTH, rows / (2 * _HEIGHT))
    y, x = ((np.arange(many / scale) * scale).astype(int) for many in free.shape)
    framed = np.pad(~free[y][:, x], 1, constant_values=True)
    walls = np.pad(framed, ((0, len(framed) % 2), (0, 0)))
    return "\n".join(
        "".join(_HALVES[2 * top + bottom] for top, bottom in zip(*pair, strict=True))
        for pair in walls.astype(int).reshape(-1, 2, walls.shape[1])
    )
