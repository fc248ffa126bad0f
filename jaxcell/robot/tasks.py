import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..automata import Filter
from .walker import cell_strides


@dataclasses.dataclass(frozen=True)
class Task:
    """A filter or a plan in a file, with what a robot has to know of its map."""

    path: Path
    cell: float
    "Side of a cell, in metres."
    directions: int
    "Number of directions."
    step: float
    "Length of a step, in metres."
    radius: float
    "Radius of the robot that it is for, in metres."

    @property
    def strides(self) -> Float[np.ndarray, "directions 2"]:
        """See [`jaxcell.robot.walker.cell_strides`][]."""
        return cell_strides(self.directions, self.cell, self.step)

    @property
    def header(self) -> dict[str, Any]:
        """What the log of a run says of it."""
        return {
            "file": str(self.path.absolute()),
            "sha256": digest(self.path),
            "cell_m": self.cell,
            "directions": self.directions,
            "step_m": self.step,
        }


@dataclasses.dataclass(frozen=True)
class FilterTask(Task):
    """A localization filter."""

    filter: Filter
    bounce: float
    "The bouncing angle that it is for, in radians."

    @property
    def header(self) -> dict[str, Any]:
        return {"kind": "filter", **super().header, "bounce_deg": math.degrees(self.bounce)}


@dataclasses.dataclass(frozen=True)
class PlanTask(Task):
    """A navigation plan."""

    start: int
    "The cell that it starts in."
    actions: tuple[float, ...]
    "0 for a step, else the angle to turn by at a bump, in radians."

    @property
    def header(self) -> dict[str, Any]:
        return {"kind": "plan", **super().header, "start": self.start, "actions": self.actions}


def load_task(path: str | os.PathLike[str]) -> FilterTask | PlanTask:
    """Reads what a robot is to run.

    **Arguments:**

    - `path`: the `filter.jxf` of `jaxcell localize --out`, or the `summary.json` of
        `jaxcell navigate --out`.

    **Raises:** `ValueError` that names the file and the field, if it is neither or has no plan;
    `FileNotFoundError`.
    """
    path = Path(path)
    if path.suffix != ".json":
        filter = Filter.load(path)
        fields = _Fields(path, filter.metadata)
        common = fields.common
        return FilterTask(**common, filter=filter, bounce=math.radians(fields.number("bounce_deg")))
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON: {error}") from None
    fields = _Fields(path, summary if isinstance(summary, dict) else {})
    if fields.values.get("found") is False:
        raise ValueError(f"{path}: found: there is no path to the goal, so no plan to run")
    actions = fields.values.get("actions_deg")
    if not isinstance(actions, list) or not all(map(_is_number, actions)):
        raise ValueError(
            f"{path}: actions_deg: expected a list of angles, as in the summary.json of "
            f"`jaxcell navigate --out`, got {actions!r}"
        )
    return PlanTask(
        **fields.common,
        start=int(fields.number("start")),
        actions=tuple(map(math.radians, actions)),
    )


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclasses.dataclass(frozen=True)
class _Fields:
    path: Path
    values: Mapping[str, Any]

    def number(self, name: str) -> float:
        value = self.values.get(name)
        if not _is_number(value):
            raise ValueError(
                f"{self.path}: {name}: expected a finite number, as `jaxcell localize` and "
                f"`jaxcell navigate` write it, got {value!r}"
            )
        assert value is not None
        return float(value)

    @property
    def common(self) -> dict[str, Any]:
        return {
            "path": self.path,
            "cell": self.number("cell_m"),
            "directions": int(self.number("directions")),
            "step": self.number("step_m"),
            "radius": self.number("robot_radius_m"),
        }


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value)
