import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Real
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from ..base.indices import as_array
from ..base.quantities import Result, derived, quantities, quantity
from ..space.box import Box
from .answers import answer_along
from .basin import Basins, basins_of_each
from .batches import in_threads
from .imaging import Say
from .maps import Map


Params: TypeAlias = Mapping[str, Any] | Sequence[float | int] | Real[np.ndarray, "members"]
# Largest numbers of cells and of parameters in a batch, and of random orbits per parameter.
_CELLS = 1 << 20
_TOGETHER = 64
_SCATTERED = 64
# Attractors farther apart than this share of the box are different.
_FAR = 0.1


def _of_each(name: str) -> Any:
    """Define a quantity of each attractor for each set of parameters, as in [`Basins`][]."""
    about = quantities(Basins)[name]
    dims = " ".join(["branch", *about.dims[1:]])

    def values(branches: "Continuation") -> Any:
        parts = [getattr(member, name) for member in branches.members]
        if about.kind == "text":
            return [text for part in parts for text in part]
        return None if parts[0] is None else np.concatenate(parts)

    options = {"kind": about.kind, "listed": about.listed}
    return derived(dims, about.meaning, about.units, **options)(values)


@dataclasses.dataclass(frozen=True, eq=False)
class Continuation(Result):
    """Attractors and basins along a list of parameters; matching attractors have the same name."""

    title: ClassVar[str] = "Attractors along parameters"
    tables: ClassVar[Mapping[str, str]] = {"branch": "branch", "member": "members", "name": "names"}

    params: Mapping[str, Float[np.ndarray, "members"]]
    "The values of each parameter that varies, by the name of the parameter."
    # A list, because a tuple would add tables to the summary.
    members: list[Basins]
    "The basins for each set of parameters."
    label: tuple[Int[np.ndarray, "_"], ...]
    "For each member, the names of its attractors: numbers that stay the same along the list."
    fraction: Annotated[
        Float[np.ndarray, "members names"],
        quantity("member name", "cells that lead to the attractor", kind="share"),
    ]

    @property
    def answer(self) -> tuple[str, ...]:
        return answer_along(self)

    @property
    def remarks(self) -> tuple[str, ...]:
        of_members = zip(self.parameters, self.members, strict=True)
        doubted = [(where, basins.remarks) for where, basins in of_members if basins.remarks]
        if not doubted:
            return ()
        (where, remarks), count = doubted[0], len(doubted)
        heading = f"{count} of {len(self.members)} parameters have remarks, as {where}:"
        return (" ".join([heading, *remarks]),)

    @derived("", "attractors of all parameters", kind="count")
    def attractors(self) -> int:
        return self.fraction.shape[1]

    @derived("member", "parameters that vary", kind="text")
    def parameters(self) -> list[str]:
        each = zip(*self.params.values(), strict=True)
        return [
            ", ".join(f"{n}={v:.6g}" for n, v in zip(self.params, row, strict=True)) for row in each
        ]

    @derived("member", "number of attractors", kind="count")
    def count(self) -> Int[np.ndarray, "members"]:
        return np.array([member.attractors for member in self.members], np.int64)

    @derived("member", "whether orbits reached the attractors and stay on them", kind="flag")
    def settled(self) -> Bool[np.ndarray, "members"]:
        return np.array([member.settled for member in self.members], bool)

    @derived("member", "cells that lead out of the box", kind="share")
    def outside_share(self) -> Float[np.ndarray, "members"]:
        return np.array([member.outside_share for member in self.members])

    @derived("branch", "parameters that vary", kind="text")
    def branch_parameters(self) -> list[str]:
        each = zip(self.parameters, self.label, strict=True)
        return [where for where, own in each for _ in own]

    @derived("branch", "name of the attractor", kind="index")
    def branch_name(self) -> Int[np.ndarray, "branches"]:
        return np.concatenate([np.zeros(0, np.int64), *self.label])

    branch_kind = _of_each("kind")
    branch_period = _of_each("period")
    branch_return_time = _of_each("return_time")
    branch_point = _of_each("point")
    branch_lower = _of_each("lower")
    branch_upper = _of_each("upper")

    @derived("name", "first parameters with the attractor, by their number", kind="index")
    def appears(self) -> Int[np.ndarray, "names"]:
        return np.argmax(self.fraction > 0, axis=0)

    @derived("name", "last parameters with the attractor, by their number", kind="index")
    def vanishes(self) -> Int[np.ndarray, "names"]:
        return len(self.members) - 1 - np.argmax(self.fraction[::-1] > 0, axis=0)

    @derived(
        "name", "attractor whose basin it is in once it has vanished, -1 for none", kind="index"
    )
    def merges(self) -> Int[np.ndarray, "names"]:
        into = np.full(self.attractors, -1)
        for name, last in enumerate(self.vanishes):
            if last + 1 == len(self.members):
                continue
            was, now = self.members[last], self.members[last + 1]
            cells = was.attractor_cells[int(np.flatnonzero(self.label[last] == name)[0])]
            votes = np.bincount(now.basin[cells] + 1, minlength=now.attractors + 1)
            into[name] = np.append(self.label[last + 1], -1)[votes.argmax() - 1]
        return into


def continuation(
    map: Map, box: Box, params: Params, *, say: Say | None = None, **options: Any
) -> Continuation:
    """Find attractors and basins for each set of parameters in a list, and match them along it.

    It runs on the host, because the number of attractors depends on the parameters.

    An attractor may match an earlier attractor if it lies in the basin of that attractor, or if the
    Hausdorff distance of their orbits is small. The matching with the smallest total distance is
    chosen. If an attractor vanishes, an attractor that later appears in the same place gets its
    name. `merges` reports the attractor in whose basin a vanished attractor lies.

    **Arguments:** as for [`jaxcell.dynamics.basins`][], except that each value of `params` is a
    number, or an array if the parameter varies; all arrays have the same length. If the map has one
    parameter, a number, `params` is the array of its values. **Returns:** the basins for each entry
    of these arrays, and the names of the attractors.

    A second attractor appears, and takes half of the box:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> branches = dynamics.continuation(
        ...     lambda x, p: jnp.where(x > p["edge"], 0.95, 0.25),
        ...     space.Box([0], [1], cells=[20]),
        ...     {"edge": [1.0, 0.75, 0.5]},
        ... )
        >>> branches.fraction.tolist(), branches.appears.tolist()
        ([[1.0, 0.0], [0.75, 0.25], [0.5, 0.5]], [0, 1])
        >>> branches.vanishes.tolist(), branches.merges.tolist()
        ([2, 2], [-1, -1])
    """
    if isinstance(params, Mapping):
        each = listed(params)
    else:
        params = {"parameter": as_array(params, "params", "; expected values of each parameter")}
        each = [one["parameter"] for one in listed(params)]
    members: list[Basins] = []

    def compute(batch: list[Any]) -> list[Basins]:
        return basins_of_each(map, box, batch, scattered=_SCATTERED, **options)

    for part in in_threads(compute, parts(each, box)):
        members += part
        if say is not None:
            say("parameters", len(members), len(each))
    label = match(members)
    names = 1 + max((int(own.max(initial=-1)) for own in label), default=-1)
    fraction = np.zeros((len(members), names))
    for k, (member, name) in enumerate(zip(members, label, strict=True)):
        fraction[k, name] = member.fraction
    varying = {name: np.asarray(value) for name, value in params.items() if np.ndim(value)}
    return Continuation(varying, members, label, fraction)


def parts(members: list[Any], box: Box) -> Iterator[list[Any]]:
    """Divide sets of parameters into lists that have at most a million cells together."""
    together = int(np.clip(_CELLS // box.size, 1, _TOGETHER))
    for first in range(0, len(members), together):
        yield members[first : first + together]


def listed(params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a dictionary of numbers for each entry of the arrays in `params`."""
    lengths = {name: len(value) for name, value in params.items() if np.ndim(value)}
    if not lengths:
        raise ValueError("params: expected an array for at least one parameter")
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        raise ValueError(f"params: expected arrays of one length: {counts}")
    return [
        {name: value[k] if np.ndim(value) else value for name, value in params.items()}
        for k in range(next(iter(lengths.values())))
    ]


def match(members: Sequence[Basins]) -> tuple[Int[np.ndarray, "_"], ...]:
    """Number attractors along a list of basins, so that those that match have the same number."""
    labels: list[np.ndarray] = []
    # For each name, the last basins with the attractor, and its number in them.
    known: dict[int, tuple[Basins, int]] = {}
    for now in members:
        names = np.full(now.attractors, -1)
        if known and now.attractors:
            cost = np.array(
                [[_cost(*old, now, k) for k in range(now.attractors)] for old in known.values()]
            )
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < 1:
                    names[column] = list(known)[row]
        for k in np.flatnonzero(names < 0):
            names[k] = max(known, default=-1) + 1
            known[int(names[k])] = (now, int(k))
        known |= {int(name): (now, k) for k, name in enumerate(names)}
        labels.append(names)
    return tuple(labels)


def _cost(old: Basins, was: int, now: Basins, k: int) -> float:
    """Return the cost of matching attractor `was` of `old` with `k` of `now`; 2 if impossible."""
    box = now.box
    index = old.box.index(now.orbit[k])
    inside = index[index < box.size]
    enclosed = inside.size > 0 and np.mean(old.basin[inside] == was)
    apart = _hausdorff_distance(box, old.orbit[was], now.orbit[k])
    if apart > _FAR and not enclosed:
        return 2.0
    return min(0.99, apart) if enclosed else 0.5 + min(0.49, apart)


def _hausdorff_distance(box: Box, *orbits: np.ndarray) -> float:
    size = np.array(box.upper) - np.array(box.lower)
    around = np.array([kind == "periodic" for kind in box.axes])
    first, second = ((orbit - np.array(box.lower)) / size for orbit in orbits)
    first, second = (np.where(around, place % 1.0 % 1.0, place) for place in (first, second))
    ahead, back = (cKDTree(place, boxsize=around.astype(float)) for place in (first, second))
    return float(max(ahead.query(second)[0].max(), back.query(first)[0].max()))
