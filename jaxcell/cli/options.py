import dataclasses
import json
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ..files import replacing
from .terminal import note, note_results, status


if TYPE_CHECKING:
    from ..space import CellSpace
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapOptions:
    """What every command that reads a map takes."""

    map: tyro.conf.Positional[Path]
    """Map file: our .json, a ROS map_server .yaml, or an ASCII grid .txt."""
    directions: int | None = None
    """Number of directions; by default what the map suggests, or 8."""
    cell: float | None = None
    """Side of a cell in metres; by default what the map suggests."""
    robot_radius: float | None = None
    """Radius of a disc robot in metres; by default what the map says."""
    step: float | None = None
    """Length of a step in metres; by default one cell."""
    collision: Literal["swept", "endpoint"] = "swept"
    """Whether the whole of a step has to be free, or only its end, as in the dissertation."""

    def cells(self) -> "CellSpace":
        """Reads the map and cuts it into cells."""
        from ..space import CellSpace

        return CellSpace.load(
            self.map,
            cell=self.cell,
            directions=self.directions,
            robot_radius=self.robot_radius,
        )

    @property
    def motion(self) -> dict[str, Any]:
        """How the robot moves, for the functions of `jaxcell.bounce`."""
        return {"step": self.step, "collision": self.collision}

    def spec(self, cells: "CellSpace") -> dict[str, Any]:
        """What determines the cells and their images, for the provenance of results."""
        assert cells.workspace is not None
        return {
            "map": str(self.map),
            "name": cells.workspace.name,
            "robot_radius_m": cells.workspace.robot_radius,
            "cell_m": cells.cell,
            "directions": cells.directions,
            "positions": cells.positions,
            "cells": cells.size,
            "pieces": cells.workspace.pieces,
            "step_m": cells.cell if self.step is None else self.step,
            "collision": self.collision,
        }


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go."""

    out: Path | None = None
    """Directory for the results: NetCDF, a Rerun recording, summary.json."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""
    verify: bool = False
    """Compute small parts of the result again by another route; exit with 1 if they differ."""

    def finish(
        self,
        summary: dict[str, Any],
        show: Callable[[], None],
        compare: Callable[[Any], "Sequence[Comparison]"],
    ) -> int:
        """Writes `summary.json`, and then prints the summary as JSON, or shows it to people.

        **Arguments:**

        - `summary`: what was found.
        - `show`: prints it for people.
        - `compare`: computes parts of it again where that is asked for, given `jaxcell.verify`.

        **Returns:** the exit status: 1 if these differ, else 0.
        """
        name = command_name(type(self))
        summary = {"command": f"jaxcell {name}", **summary}
        verified = _verified(compare) if self.verify else None
        if verified is not None:
            summary["verified"] = verified
        if self.out is not None:
            write_text(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        if self.json:
            print(json.dumps(summary))
        else:
            show()
            if self.out is not None:
                note_results(self.out)
        if verified is None:
            return 0
        for one in verified["comparisons"]:
            if not one["agrees"]:
                print(f"jaxcell {name}: --verify: {one['what']}: {one['where']}", file=sys.stderr)
        if verified["agrees"] and not self.json:
            note(
                f"Verified: {verified['count']:,} numbers agree with another route, in "
                f"{verified['seconds']:g} s."
            )
        return 0 if verified["agrees"] else 1


def _verified(compare: Callable[[Any], "Sequence[Comparison]"]) -> dict[str, Any]:
    """What came of computing parts of a result again."""
    from .. import verify

    began = time.perf_counter()
    with status("computing parts again by another route"):
        found = compare(verify)
    return {
        "agrees": all(one.agrees for one in found),
        "count": sum(one.count for one in found),
        "seconds": round(time.perf_counter() - began, 3),
        "comparisons": [one.as_json() for one in found],
    }


def command_name(command: type) -> str:
    """The name on the command line of a class of options: `patrol map` for `PatrolMap`."""
    return re.sub("(?<=[a-z])(?=[A-Z])", " ", command.__name__).lower()


def check_out(out: Path, folder: bool) -> None:
    """Refuses a place for results where none can be written, before they are computed.

    **Raises:** `NotADirectoryError` or `PermissionError`.
    """
    places = [out.absolute(), *out.absolute().parents]
    place = next(place for place in places if place.exists())
    if not place.is_dir() and (folder or place != places[0]):
        raise NotADirectoryError(f"--out {out}: {place} is no directory")
    if not os.access(place, os.W_OK):
        raise PermissionError(f"--out {out}: {place} cannot be written to")


def write_text(path: Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
