from collections.abc import Sequence

import networkx as nx
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
import xarray as xr
from jaxtyping import Float, Int

from ..certificate import Outcome
from ..drift import Deployment, LongTermBehaviour, Water
from ..markov import Absorption
from .bounce import sample
from .comparison import Comparison


_IMAGES = 60
_LAYERS = 3
# Of a sparse direct solve, and of graphs of Python objects.
_MOST_TRANSIENT = 20_000
_MOST_NODES = 20_000
# Of an elimination, which takes the cube of it.
_MOST_DENSE = 700
_SINK = -1


def compare_drift(
    currents: xr.Dataset,
    waters: Sequence[Water],
    behaviours: Sequence[LongTermBehaviour],
    ends: Sequence[Absorption | None],
    deployment: Deployment,
    *,
    rho: float,
    spread: str,
    edge: str,
    samples: int = 5,
) -> list[Comparison]:
    """The drift of some cells, and where drifters end, in plain NumPy and by direct solves.

    **Arguments:**

    - `currents`: as from [`jaxcell.drift.open_currents`][]; the flow is the mean of its records.
    - `waters`, `behaviours`, `ends`: of each layer; the probabilities may be unknown.
    - `deployment`: that of the surface.
    - `rho`, `spread`, `edge`, `samples`: as for [`jaxcell.drift.drift_map`][].
    """
    found = []
    for layer, water in list(enumerate(waters))[:_LAYERS]:
        behaviour, name = behaviours[layer], f" at {water.depth:g} m"
        P = behaviour.chain.to_scipy()
        drifter = _Drifter(currents, water, layer, behaviour.duration, rho, spread, edge, samples)
        differ, wrong = [0.0], [""]
        for z in sample(water.cells, _IMAGES).tolist():
            row, expected = P[[z]], drifter.images(z)
            told = dict(zip(row.indices.tolist(), row.data.tolist(), strict=True))
            for to in told.keys() | expected.keys() - {_SINK}:
                differ.append(abs(told.get(to, 0.0) - expected.get(to, 0.0)))
                wrong.append(
                    f"cell {z} to {to}: {told.get(to, 0.0):g}, and {expected.get(to, 0.0):g} anew"
                )
        worst = int(np.argmax(differ))
        what = f"images of cells{name}, one at a time"
        found.append(Comparison(what, len(differ) - 1, differ[worst], 1e-9, wrong[worst]))
        found += _compare_long_term(P, behaviour, ends[layer], name)
    reached = _reached(behaviours[0].chain.to_scipy(), deployment.cells.tolist())
    missed = [f"cell {z} is visited from none" for z in range(waters[0].cells) if z not in reached]
    what = "cells visited from the deployment, by a search"
    return [*found, Comparison.exact(what, missed, waters[0].cells)]


class _Drifter:
    """Where a drifter of one cell may be a step later."""

    def __init__(
        self,
        currents: xr.Dataset,
        water: Water,
        layer: int,
        duration: float,
        rho: float,
        spread: str,
        edge: str,
        samples: int,
    ) -> None:
        self.water, self.duration, self.rho, self.samples = water, duration, rho, samples
        self.spread, self.exits = spread, edge == "exit"
        east, north = (
            np.nan_to_num(currents[name].isel(layer=layer).values.astype(float)).mean(axis=0)
            for name in "uv"
        )
        wet = water.number >= 0
        cos, sin = np.cos(water.angle), np.sin(water.angle)
        self.rate = [
            np.where(wet, (east * cos + north * sin) / water.dx, 0),
            np.where(wet, (north * cos - east * sin) / water.dy, 0),
        ]

    def images(self, z: int) -> dict[int, float]:
        """The cells and their probabilities; -1 for off the grid."""
        column, row = int(self.water.column[z]), int(self.water.row[z])
        around = [
            self._at(row + up, column + right)
            for up in (-1, 0, 1)
            for right in (-1, 0, 1)
            if up or right
        ]
        beside = [cell for cell in around if cell is not None and cell >= 0]
        if not self.exits and len(beside) < 8:
            return {cell: 1 / (len(beside) + 1) for cell in (z, *beside)}
        if self.spread == "sampled":
            found: dict[int, float] = {}
            off = (np.arange(self.samples) + 0.5) / self.samples - 0.5
            for up in off:
                for right in off:
                    to = self._landing(z, *self._end(column + right, row + up))
                    found[to] = found.get(to, 0.0) + 1 / self.samples**2
            return found
        x, y = self._end(column, row)
        image = self._landing(z, x, y)
        others = self._turned(z, x, y) if self.spread == "turned" else self._around(z, image, x, y)
        others = [to for to in dict.fromkeys(others) if to != image]
        if not others:
            return {image: 1.0}
        return {image: self.rho, **{to: (1 - self.rho) / len(others) for to in others}}

    def _end(self, x: float | int, y: float | int) -> tuple[float, float]:
        rows, columns = self.water.number.shape
        rates, low_x = self.rate, np.clip(x, 0, columns - 1)
        if self.water.wraps:
            # The first column once more, after the last.
            rates, low_x = [np.column_stack([one, one[:, 0]]) for one in rates], x % columns
            columns += 1
        low_y = np.clip(y, 0, rows - 1)
        i, j = min(int(low_x), max(columns - 2, 0)), min(int(low_y), max(rows - 2, 0))
        across, up = low_x - i, low_y - j
        speed = []
        for rate in rates:
            corners = rate[j : j + 2, i : i + 2]
            corners = np.pad(corners, [(0, 2 - s) for s in corners.shape], mode="edge")
            speed.append(np.array([1 - up, up]) @ corners @ np.array([1 - across, across]))
        return x + self.duration * speed[0], y + self.duration * speed[1]

    def _at(self, row: int, column: int) -> int | None:
        """The cell in a square: -1 for land, `None` off the grid."""
        rows, columns = self.water.number.shape
        if self.water.wraps:
            column %= columns
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        return int(self.water.number[row, column])

    def _square(self, x: float, y: float) -> tuple[int, int]:
        return int(np.floor(np.round(y + 0.5, 9))), int(np.floor(np.round(x + 0.5, 9)))

    def _landing(self, z: int, x: float, y: float) -> int:
        water = self.water
        to = self._at(*self._square(x, y))
        if to is None and self.exits:
            return _SINK
        if to is not None and to >= 0 and water.piece[to] == water.piece[z]:
            return to
        here = water.row[z], water.column[z]
        across = np.abs(water.column - x)
        if water.wraps:
            columns = water.number.shape[1]
            across %= columns
            across = np.minimum(across, columns - across)
        away = np.hypot(across * water.dx[here], (water.row - y) * water.dy[here])
        away[water.piece != water.piece[z]] = np.inf
        return int(np.flatnonzero(away <= away.min() * (1 + 1e-9))[0])

    def _turned(self, z: int, x: float, y: float) -> list[int]:
        water = self.water
        here = water.row[z], water.column[z]
        side = np.array([water.dx[here], water.dy[here]])
        way = np.array([x - water.column[z], y - water.row[z]]) * side
        found = []
        for angle in (np.pi / 4, -np.pi / 4):
            cos, sin = np.cos(angle), np.sin(angle)
            right, up = np.array([[cos, -sin], [sin, cos]]) @ way / side
            found.append(self._landing(z, water.column[z] + right, water.row[z] + up))
        return found

    def _around(self, z: int, image: int, x: float, y: float) -> list[int]:
        water, found = self.water, []
        row, column = self._square(x, y)
        if image >= 0:
            row, column = int(water.row[image]), int(water.column[image])
        for up in (-1, 0, 1):
            for right in (-1, 0, 1):
                to = self._at(row + up, column + right)
                if to is None and self.exits:
                    found.append(_SINK)
                elif to is not None and to >= 0 and water.piece[to] == water.piece[z]:
                    found.append(to)
        return found


def _compare_long_term(
    P: scipy.sparse.csr_array,
    behaviour: LongTermBehaviour,
    ends: Absorption | None,
    name: str,
) -> list[Comparison]:
    group = np.asarray(behaviour.groups.group)
    found = [_compare_groups(P, group, name)]
    transient = np.flatnonzero(group < 0)
    Q, later = P[transient][:, transient], P[transient]
    missing = 1 - np.asarray(later.sum(axis=1)).ravel()
    first = np.asarray(later @ (group == 0).astype(float))
    others = np.asarray(later @ (group > 0).astype(float)) + np.where(missing > 1e-12, missing, 0)
    when, where = (
        "times until drifters are in a group or gone",
        "shares that end in the first group",
    )
    how = "elimination" if transient.size <= _MOST_DENSE else "a sparse direct solve"
    when, where = f"{when}{name}, by {how}", f"{where}{name}, by {how}"
    if not 0 < transient.size <= _MOST_TRANSIENT:
        why = f"{transient.size:,} transient cells; it is done for 1 to {_MOST_TRANSIENT:,}"
        return [*found, Comparison.omitted(when, why)]
    if transient.size <= _MOST_DENSE:
        # Groups that are none leave nothing to divide by, and times that are no numbers.
        with np.errstate(divide="ignore", invalid="ignore"):
            chances, times = _eliminate(Q.toarray(), first, others)
    elif behaviour.absorption.certificate.outcome is Outcome.CONVERGED:
        system = scipy.sparse.eye_array(transient.size) - Q
        solve = scipy.sparse.linalg.splu(system.tocsc()).solve
        chances, times = solve(first), solve(np.ones(transient.size))
    else:
        # Drifters stay almost for ever somewhere, where a solve that subtracts is far off.
        return [*found, Comparison.omitted(when, "they are not certified")]
    told = np.asarray(behaviour.absorption.value)[transient]
    found.append(Comparison.close(when, told, times, 1e-6, relative=True))
    if ends is not None and behaviour.groups.count:
        told = np.asarray(ends.value)[0][transient]
        found.append(Comparison.close(where, told, chances, 1e-7))
    return found


def _eliminate(
    Q: Float[np.ndarray, "cells cells"],
    first: Float[np.ndarray, "cells"],
    others: Float[np.ndarray, "cells"],
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells"]]:
    """The probability of the first end, and the steps to any, by taking out cell after cell.

    Nothing is subtracted (Grassmann, Taksar and Heyman 1985), so that times of any length are
    good.
    """
    count = len(Q)
    # Of each cell: to which it goes on, how it ends, and how many steps that takes.
    table = np.column_stack([Q, first, others, np.ones(count)])
    for last in range(count - 1, -1, -1):
        table[last] /= table[last, :last].sum() + table[last, count : count + 2].sum()
        by_way = table[:last, last].copy()
        table[:last, :last] += np.outer(by_way, table[last, :last])
        table[:last, count:] += np.outer(by_way, table[last, count:])
    chances, times = np.zeros((2, count))
    for cell in range(count):
        chances[cell] = table[cell, count] + table[cell, :cell] @ chances[:cell]
        times[cell] = table[cell, count + 2] + table[cell, :cell] @ times[:cell]
    return chances, times


def _compare_groups(
    P: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"], name: str
) -> Comparison:
    what = f"persistent groups{name}, by networkx"
    if len(group) > _MOST_NODES:
        return Comparison.omitted(what, f"more than {_MOST_NODES:,} cells")
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(group)))
    entries = P.tocoo()
    graph.add_edges_from(zip(entries.row.tolist(), entries.col.tolist(), strict=True))
    leaves = set(np.flatnonzero(np.asarray(P.sum(axis=1)).ravel() < 1 - 1e-12).tolist())
    closed = {
        frozenset(cells) for cells in nx.attracting_components(graph) if not leaves & set(cells)
    }
    told = {frozenset(np.flatnonzero(group == one).tolist()) for one in range(int(group.max()) + 1)}
    wrong = [
        f"{len(cells)} cells from {min(cells)} on are {'no' if cells in told else 'a'} group"
        for cells in sorted(told ^ closed, key=min)
    ]
    return Comparison.exact(what, wrong, len(group))


def _reached(P: scipy.sparse.csr_array, cells: list[int]) -> set[int]:
    reached, new = set(cells), list(cells)
    while new:
        z = new.pop()
        later = set(P.indices[P.indptr[z] : P.indptr[z + 1]].tolist()) - reached
        reached |= later
        new += later
    return reached
