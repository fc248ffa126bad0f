"""Make the rows of the tables of `drifters.py`, beside the numbers of the source."""

import dataclasses
from typing import Any

import numpy as np
import scipy.optimize
from scipy.sparse import csgraph

from jaxcell.drift import (
    CoverageCurve,
    Sea,
    VisibleDeployment,
    coverage_curve,
    deployment_cells,
    minimum_deployment,
    reachable_at_depth,
    reachable_by_layer,
)
from jaxcell.mapping import Chain
from jaxcell.optimize import minimum_cover

from ..shared.report import Rows
from .drifters_sea import Layer, Ocean


# Section 5.5.1, for another sea, whose data are not public.
SOURCE = {"of": "Alam 2018", "persistent": 2, "single": 2, "multiple": 1, "drifters": 27}
SOURCE_VIEWS = {"of": "Alam 2018", "greedy": 16, "in groups": 9, "kept": 8}
MILP_SECONDS = 20.0
# The largest matrix of pairs of cells, in bytes.
_LARGEST_TABLE = 10_000**2


def longest(values: np.ndarray) -> float:
    return float(np.max(values, initial=0.0))


# Behaviour and deployment: Figures 5.7 to 5.9.


def behaviour_row(of: str, layer: Layer) -> dict[str, Any]:
    """Describe the groups of a layer, and the effects of the grid on them."""
    transient = layer.behaviour.transient
    single = int(transient.single.sum())
    return {
        "of": of,
        "cells": layer.water.cells,
        "step, h": layer.duration / 3600,
        "persistent": layer.behaviour.groups.count,
        "single": single,
        "multiple": transient.count - single,
        "drifters": deployment_cells(layer.behaviour).cells.size,
        "longest, h": longest(layer.hours),
        "held": layer.held,
        "locked": layer.diagnosis.locked,
        "self, %": 100 * layer.diagnosis.self_image,
    }


def group_rows(layer: Layer) -> Rows:
    """Describe each group, the largest first, with the drifters of Alg. 5.2 and the fewest."""
    chosen = deployment_cells(layer.behaviour)
    matrix = layer.chain.to_scipy()
    transient, groups = layer.behaviour.transient, layer.behaviour.groups
    names = ("group", "cells", "Alg. 5.2", "fewest", "mean, h", "longest, h")
    rows: list[tuple] = []
    for group in range(groups.count):
        count = int((chosen.group == group).sum())
        rows.append((f"persistent {group + 1}", int(groups.size[group]), count, 1, 0.0, 0.0))
    for part in range(transient.count):
        cells = np.flatnonzero(layer.transient == part)
        inside = Chain.from_scipy(matrix[cells][:, cells])
        count, fewest = int((chosen.transient_group == part).sum()), minimum_deployment(inside).size
        hours = layer.hours[cells]
        times = float(hours.mean()), float(hours.max())
        rows.append((f"transient, to {layer.homes(part)}", cells.size, count, fewest, *times))
    rows.sort(key=lambda row: -row[1])
    return [dict(zip(names, row, strict=True)) for row in rows]


def view_row(layer: Layer, views: VisibleDeployment, reach: float) -> dict[str, Any]:
    """Describe the cameras of Figure 5.9, and compute the fewest cells that see all cells."""
    water = layer.water
    fewest = bound = None
    if water.cells**2 <= _LARGEST_TABLE:
        dx, dy = (sides[water.row, water.column][:, None] for sides in (water.dx, water.dy))
        right = (np.abs(water.column - water.column[:, None]) + 0.5) * dx
        up = (np.abs(water.row - water.row[:, None]) + 0.5) * dy
        seen = np.hypot(right, up) <= reach * (1 + 1e-9)
        cover = minimum_cover(seen, time_limit=MILP_SECONDS, throw=False)
        fewest, bound = cover.chosen.size, cover.bound
    return {
        "of": "this sea",
        "greedy": views.cover.size,
        "in groups": int((layer.group[views.cover] >= 0).sum()),
        "kept": views.cells.size,
        "fewest": fewest,
        "at least": bound,
    }


def deployment_rows(ocean: Ocean, record: int) -> tuple[Rows, dict[str, CoverageCurve]]:
    """Count the drifters that reach all cells for each kind of map, and compute coverage curves."""
    rows, curves = [], {}
    for name, options in (
        ("as in the source", {}),
        ("without disturbances", {"rho": 1.0}),
        ("points of the cell", {"spread": "sampled"}),
        ("with a way out", {"edge": "exit"}),
        ("points, and a way out", {"spread": "sampled", "edge": "exit"}),
        ("all neighbours", {"spread": "all"}),
    ):
        layer = ocean.layer(record, 0, **options)
        curve = coverage_curve(layer.chain)
        chosen = deployment_cells(layer.behaviour).cells
        some = curve.covered / layer.water.cells
        rows.append(
            {
                "map": name,
                "groups": layer.behaviour.groups.count,
                "transient": layer.behaviour.transient.count,
                "Alg. 5.2": chosen.size,
                "fewest": minimum_deployment(layer.chain).size,
                "MILP": fewest_by_program(layer.chain),
                "greedy": curve.cells.size,
                "for 90 %": int(np.argmax(some >= 0.9)) + 1,
                "one, %": 100 * float(some[0]),
                "all": bool(reaches_all(layer.chain, chosen)),
            }
        )
        curves[name] = curve
    return rows, curves


def fewest_by_program(chain: Chain) -> int | None:
    """Compute the fewest cells that lead to all cells, by a mixed-integer program.

    The program is scipy's. The result is `None` if it takes too long, or cells are too many.
    """
    if chain.cells**2 > _LARGEST_TABLE:
        return None
    leads = np.isfinite(csgraph.shortest_path(chain.to_scipy(), unweighted=True))
    program = scipy.optimize.milp(
        np.ones(chain.cells),
        integrality=np.ones(chain.cells),
        bounds=(0, 1),
        constraints=scipy.optimize.LinearConstraint(leads.T.astype(float), 1, np.inf),
        options={"time_limit": MILP_SECONDS, "mip_rel_gap": 0},
    )
    return round(program.fun) if program.status == 0 else None


def reaches_all(chain: Chain, cells: np.ndarray) -> bool:
    """Test whether all cells may be visited from `cells`, independently of the library."""
    matrix = chain.to_scipy().T.tocsr()
    reached = np.zeros(chain.cells, bool)
    reached[cells] = True
    while True:
        more = reached | (matrix @ reached.astype(np.float64) > 0)
        if (more == reached).all():
            return bool(reached.all())
        reached = more


# Sensitivity.


def step_rows(ocean: Ocean, record: int) -> Rows:
    """Compute the groups for steps that are a multiple of the time to cross a cell."""
    own = ocean.layer(record).duration
    rows = []
    for factor in (0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 3.0):
        stepped = dataclasses.replace(ocean, step=factor * own)
        layer = stepped.layer(record)
        sharp = stepped.layer(record, rho=1.0)
        points = stepped.layer(record, spread="sampled")
        rows.append(
            {
                "step": factor,
                **_sensitive(layer),
                "rho = 1": sharp.behaviour.groups.count,
                "points": points.behaviour.groups.count,
                "drift, cells": layer.diagnosis.mean_shift,
                "self, %": 100 * layer.diagnosis.self_image,
                "warned": "yes" if layer.diagnosis.warning else "",
            }
        )
    return rows


def rho_rows(ocean: Ocean, record: int) -> Rows:
    return [
        {"rho": rho, **_sensitive(ocean.layer(record, rho=rho))}
        for rho in (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.99, 1.0)
    ]


def _sensitive(layer: Layer) -> dict[str, Any]:
    moving = layer.hours[layer.transient >= 0]
    return {
        "persistent": layer.behaviour.groups.count,
        "drifters": deployment_cells(layer.behaviour).cells.size,
        "median, h": float(np.median(moving)) if moving.size else 0.0,
        "longest, h": longest(layer.hours),
        "held": layer.held,
    }


# Layers: Figures 5.10 to 5.15.


@dataclasses.dataclass(frozen=True, eq=False)
class Moment:
    """All layers at one time, and the cells that drifters reach from the starts."""

    record: int
    layers: list[Layer]
    "Layers with steps of their own, because they are independent in Algs. 5.1 and 5.4."
    reached: list[np.ndarray]
    "For each start, a mask of the cells of all layers that drifters reach within their layers."


def moment(ocean: Ocean, record: int) -> tuple[Moment, Rows, Rows]:
    """Compute all layers at one time, with rows for their behaviour and for their reached cells."""
    layers = [ocean.layer(record, k) for k in range(len(ocean.waters))]
    sea = Sea.of(ocean.waters, [layer.chain for layer in layers])
    reached = [reachable_by_layer(sea, start) for start in ocean.starts]
    anywhere = [reachable_at_depth(sea, start) for start in ocean.starts]
    rows, reach = [], []
    for k, layer in enumerate(layers):
        of = f"{ocean.hour(record):g} h, {layer.water.depth:g} m"
        rows.append(behaviour_row(of, layer))
        row = {"of": of, "cells": layer.water.cells}
        for start in range(len(ocean.starts)):
            row[f"start {start + 1}, in layers"] = int(reached[start][sea.layer == k].sum())
            row[f"start {start + 1}, free"] = int(anywhere[start][sea.layer == k].sum())
        reach.append(row)
    return Moment(record, layers, reached), rows, reach
