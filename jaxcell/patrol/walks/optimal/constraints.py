import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from ....base.documents import (
    Fields,
    about,
    check_file,
    checked_list,
    decode_json,
    read_text,
    refused,
)
from ....base.quantities import Result, derived
from ....optimize import Graph, Linear


_FIELDS = ("label", "edges", "vertices", "same", "each", "factors", "least", "most")
# Tolerance of a weight at a bound: the accuracy of the solver.
_AT = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class MetConstraints(Result):
    """Linear constraints on the weights of a walk, with the values that the walk reaches."""

    title: ClassVar[str] = "Constraints on a walk"
    tables: ClassVar[Mapping[str, str]] = {"constraint": "constraints"}

    constraints: Sequence[Linear]
    weights: Float[np.ndarray, "edges"]
    "The weights of the walk, with sum 1."
    prices: Float[np.ndarray, "constraints"]
    "The decrease of the mean commute time per unit of relaxation of a bound, to first order."

    @derived("constraint", "constraint", kind="coordinate")
    def constraint(self) -> list[str]:
        return [each.label for each in self.constraints]

    @derived("constraint", "at least")
    def least(self) -> Float[np.ndarray, "constraints"]:
        return np.array([each.lower for each in self.constraints])

    @derived("constraint", "value")
    def value(self) -> Float[np.ndarray, "constraints"]:
        return np.array([each.coefficients @ self.weights for each in self.constraints])

    @derived("constraint", "at most")
    def most(self) -> Float[np.ndarray, "constraints"]:
        return np.array([each.upper for each in self.constraints])

    @derived("constraint", "whether it is at a bound", kind="flag")
    def active(self) -> Bool[np.ndarray, "constraints"]:
        unit = np.array([np.abs(each.coefficients).max() for each in self.constraints])
        room = np.minimum(self.value - self.least, self.most - self.value)
        return room <= _AT * unit

    @derived("constraint", "commuting saved if it yields by 0.01", "steps")
    def saves(self) -> Float[np.ndarray, "constraints"]:
        return np.where(self.active, self.prices / 100, 0.0)


def load_constraints(
    path: str | os.PathLike[str], graph: Graph, names: Sequence[str]
) -> list[Linear]:
    """Read constraints on the shares of steps along edges, and on the shares of time at vertices.

    **Arguments:**

    - `path`: a JSON file, an object with the list `constraints`. Each constraint has either `edges`
        (a list of pairs of vertices, or `"all"`) or `vertices` (a list of names, or `"all"`). The
        bounds of the sum of their shares are `least`, `most` or both. With `"each": true` the
        bounds apply to each share separately; `factors` multiply the shares in the sum. A
        constraint may have `same` instead: a list of edges with equal shares. `label` is its name.
    - `graph`, `names`: the graph, and the names of its vertices.

    **Returns:** the constraints, for weights that sum to 1.

    At most a tenth of the steps along the last edge of a line:

        >>> from jaxcell import examples, patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> path = examples.folder() / "constraints.json"
        >>> _ = path.write_text('{"constraints": [{"edges": [["b", "c"]], "most": 0.1}]}')
        >>> (cap,) = patrol.walks.load_constraints(path, graph, "abc")
        >>> cap.label, cap.coefficients.tolist(), cap.upper
        ('edge b-c', [0.0, 1.0], 0.1)
    """
    path = Path(path)
    check_file(path, "constraints, a JSON")
    with about(path):
        document = decode_json(read_text(path), "constraints of a walk")
        if not isinstance(document, dict) or set(document) != {"constraints"}:
            raise ValueError("expected an object with the list 'constraints' alone")
        parts = Fields(document).parts("constraints")
        reader = _Reader(graph, names)
        return [constraint for part in parts for constraint in reader.read(part)]


class _Reader:
    def __init__(self, graph: Graph, names: Sequence[str]) -> None:
        self.names = list(names)
        self.shares = np.eye(len(graph.edges))
        self.visits = (np.arange(graph.vertices)[:, None, None] == graph.edges).mean(axis=2)
        ends = [[self.names[end] for end in edge] for edge in graph.edges.tolist()]
        self.places: Mapping[Any, int] = {
            **{name: i for i, name in enumerate(self.names)},
            **{frozenset(edge): i for i, edge in enumerate(ends)},
        }
        self.labels = [f"edge {'-'.join(edge)}" for edge in ends]

    def read(self, fields: Fields) -> list[Linear]:
        unknown = next((name for name in fields.values if name not in _FIELDS), None)
        if unknown is not None:
            raise ValueError(f"{fields.where}{unknown}: expected one of {', '.join(_FIELDS)}")
        kinds = [name for name in ("edges", "vertices", "same") if name in fields.values]
        if len(kinds) != 1:
            raise ValueError(f"{fields.where[:-1]}: expected either edges, vertices or same")
        rows, labels = self._rows(fields, kinds[0])
        label = fields.get("label")
        if label is not None and not isinstance(label, str):
            raise refused(f"{fields.where}label", "words", label)
        if kinds == ["same"]:
            if len(rows) < 2:
                raise fields.refused("same", "two or more edges")
            pairs = zip(rows[:-1], rows[1:], labels[:-1], labels[1:], strict=True)
            return [Linear(label or f"{a} as {b}", x - y, 0, 0) for x, y, a, b in pairs]
        lower, upper = (
            fields.number(name) if name in fields.values else free
            for name, free in (("least", -math.inf), ("most", math.inf))
        )
        if not math.isfinite(lower) and not math.isfinite(upper):
            raise ValueError(f"{fields.where[:-1]}: expected least, most or both")
        if lower > upper:
            raise refused(f"{fields.where}most", f"at least {lower:g}, the value of least", upper)
        factors = np.ones(len(rows))
        if "factors" in fields.values:
            factors = fields.numbers("factors", (len(rows),), whole=False)
        rows = factors[:, None] * rows
        each = fields.values.get("each", False)
        if not isinstance(each, bool):
            raise refused(f"{fields.where}each", "true or false", each)
        if each:
            before = "" if label is None else f"{label}, "
            named = zip(rows, labels, strict=True)
            return [Linear(f"{before}{name}", row, lower, upper) for row, name in named]
        return [Linear(label or ", ".join(labels), rows.sum(axis=0), lower, upper)]

    def _rows(
        self, fields: Fields, kind: str
    ) -> tuple[Float[np.ndarray, "rules edges"], list[str]]:
        """Return a row of coefficients and a label for each edge or vertex of a constraint."""
        given, where = fields.get(kind), f"{fields.where}{kind}"
        on_vertices = kind == "vertices"
        rows, labels = (self.shares, self.labels)
        if on_vertices:
            rows, labels = self.visits, [f"vertex {name}" for name in self.names]
        if given == "all":
            return rows, labels
        chosen = []
        for i, entry in enumerate(checked_list(where, given)):
            pair = isinstance(entry, list) and len(entry) == 2
            name = frozenset(map(str, entry)) if pair else str(entry)
            place = self.places.get(name)
            if place is None or pair == on_vertices:
                what = "a vertex" if on_vertices else "two vertices with an edge between them"
                raise refused(f"{where}[{i}]", what, entry)
            chosen.append(place)
        if not chosen or len(set(chosen)) < len(chosen):
            raise refused(where, "one or more, each once", json.dumps(given))
        return rows[chosen], [labels[place] for place in chosen]
