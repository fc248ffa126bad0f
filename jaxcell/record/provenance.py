"""Coordinates of cells and provenance attributes, for all kinds of datasets."""

import datetime
import json
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from .. import __version__
from ..base.results import current_run
from ..base.revision import git_revision
from ..space import CellSpace


def cell_coordinates(cells: CellSpace) -> dict[str, tuple[Any, ...]]:
    direction = np.arange(cells.directions)
    _, _, theta = cells.centre(direction * cells.positions)
    x, y, _ = cells.centre(np.arange(cells.positions))
    heading = {"long_name": "heading, from the x axis (East)", "units": "rad"}
    heading["sense"] = "counter-clockwise"
    centre = {"long_name": "centre of the cell", "units": "m"}
    return {
        "direction": ("direction", direction.astype(np.int32), {"long_name": "index of heading"}),
        "theta": ("direction", theta, heading),
        "theta_deg": ("direction", np.rad2deg(theta), {**heading, "units": "degree"}),
        "x": ("position", x, centre),
        "y": ("position", y, centre),
    }


def provenance(
    title: str, cells: CellSpace | None, spec: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the attributes of a dataset: its title, its parameters, and software versions."""
    try:
        parameters = json.dumps(dict(spec or {}), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"spec: expected a JSON object: {error}") from error
    attributes: dict[str, Any] = {
        "title": title,
        "source": "jaxcell; definitions of Alam 2018",
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "jaxcell_version": __version__,
        "jax_version": jax.__version__,
        "spec": parameters,
    }
    if (run := current_run()) is not None:
        attributes["run_id"] = run
    if (revision := git_revision()) is not None:
        attributes["git_revision"] = revision
    if cells is not None:
        attributes["cell_side_m"] = cells.cell
        attributes["cell_index"] = "direction * positions + position"
    return attributes
