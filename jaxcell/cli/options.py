import contextlib
import dataclasses
import json
import math
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ..files import name_in_results, replacing
from .terminal import note, note_results, say, status


if TYPE_CHECKING:
    from ..estimates import Need
    from ..space import CellSpace
    from ..verify import Comparison


# Bytes above which the need is printed.
_MUCH = 1e9


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapOptions:
    """The options of every command that reads a map."""

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

    def cells(self, need: "Need", doing: str) -> "CellSpace":
        """Read the map, and cut it into cells if what is done with them fits the memory.

        **Arguments:**

        - `need`: the bytes that this takes.
        - `doing`: what it is called.

        **Raises:** `MemoryError` if it does not fit.
        """
        from .. import estimates
        from ..space import CellSpace
        from ..space.cells import suggested
        from ..space.extent import Extent

        chosen = suggested(self.map, self.cell, self.directions, self.robot_radius)
        if (extent := Extent.about(*chosen)) is not None:
            say_memory(estimates.check(extent, need, doing, self.step), doing)
        with status(f"cutting {self.map} into cells"):
            return CellSpace.of(*chosen)

    @property
    def motion(self) -> dict[str, Any]:
        """How the robot moves, for the functions of `jaxcell.bounce`."""
        return {"step": self.step, "collision": self.collision}

    def spec(self, cells: "CellSpace") -> dict[str, Any]:
        """What determines the cells and their images, for the provenance of results."""
        assert cells.workspace is not None
        return {
            "map": name_in_results(self.map),
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


def say_memory(needed: float | int, doing: str) -> None:
    """Print how much memory something needs, if it is much."""
    from ..memory import gigabytes

    if needed > _MUCH:
        note(f"{doing} needs about {gigabytes(needed)} of memory")


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Set JAX up for a command, around the imports that take seconds."""
    with status("loading JAX"):
        from ..runtime import configure_jax

        configure_jax()
        yield


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
        """Write `summary.json`, and then print the summary as JSON, or show it to people.

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
            say(json.dumps(summary))
        else:
            show()
            if self.out is not None:
                note_results(self.out)
        if verified is None:
            return 0
        for one in verified["comparisons"]:
            if not one["agrees"]:
                note(f"jaxcell {name}: --verify: {one['what']}: {one['where']}")
        if verified["agrees"] and not self.json:
            note(
                f"Verified: {verified['count']:,} numbers agree with another route, in "
                f"{verified['seconds']:g} s."
            )
        return 0 if verified["agrees"] else 1


def _verified(compare: Callable[[Any], "Sequence[Comparison]"]) -> dict[str, Any]:
    """Compute parts of a result again, and compare."""
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


def direction_at(heading: float, directions: int) -> int:
    """The direction of the option `--heading`, in degrees.

    **Raises:** `ValueError` if there is none in which a robot has this heading.
    """
    turn = heading * directions / 360
    if not math.isfinite(turn) or abs(turn - round(turn)) > 1e-6:
        raise ValueError(
            f"--heading {heading:g}: expected a multiple of the {360 / directions:g} degrees "
            "between the directions"
        )
    return round(turn) % directions


def check_out(out: Path, folder: bool, option: str = "--out ") -> None:
    """Refuse a place for results where none can be written, before they are computed.

    **Arguments:**

    - `out`: the place.
    - `folder`: whether it is to be a folder, or a file.
    - `option`: what the message calls it.

    **Raises:** `IsADirectoryError`, `NotADirectoryError` or `PermissionError`.
    """
    wanted = out.absolute()
    if not folder:
        if wanted.is_dir():
            raise IsADirectoryError(f"{option}{out}: expected a file, and this is a directory")
        wanted = wanted.parent
    place = next(place for place in (wanted, *wanted.parents) if os.path.lexists(place))
    if not place.is_dir():
        raise NotADirectoryError(f"{option}{out}: {place} is no directory")
    try:
        # Permissions are only half of it: a disk may be full, or mounted read-only.
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise PermissionError(f"{option}{out}: {place} cannot be written to") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
