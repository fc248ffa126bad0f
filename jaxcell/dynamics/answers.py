"""Sentences that say what attractors are, and where."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.formatting import percent
from ..space.box import Box


# Largest number of attractors with a sentence.
_MOST = 8
# Coordinates closer to 0 than this share of an axis are written as 0.
_ZERO = 1e-9


def kind_of(basins: Any, k: int) -> str:
    """Name the kind of attractor `k`: a point, a cycle, or neither."""
    if basins.return_time is not None and np.isfinite(basins.return_time[k]):
        return "cycle" if basins.return_time[k] > 0 else "point"
    return {0: "neither", 1: "point"}.get(int(basins.period[k]), "cycle")


def rounded(box: Box, points: Float[np.ndarray, "... axes"]) -> Float[np.ndarray, "... axes"]:
    """Replace coordinates by 0 where only rounding separates them from it."""
    return np.where(np.abs(points) < _ZERO * box.width * box.cells, 0.0, points)


def answer_of(basins: Any) -> tuple[str, ...]:
    """Describe each attractor of [`Basins`][jaxcell.dynamics.Basins], and whether it is certain."""
    if not basins.attractors:
        return ("No attractor was found.",)
    settled = "all orbits have settled" if basins.settled else _UNSETTLED
    sentences = [
        f"Attractor {k} is {described(basins, k)}; {basins.sampled[k]:.1%} of the orbits from "
        f"random starts end on it, and {basins.fraction[k]:.1%} of the cells lead to it."
        for k in range(min(basins.attractors, _MOST))
    ]
    if out := basins.outside_share:
        sentences.append(f"{percent(out)} of the cells lead out of the box.")
    return (*sentences, *_more(basins.attractors), f"{settled[0].upper()}{settled[1:]}.")


def answer_along(branches: Any) -> tuple[str, ...]:
    """Describe the attractors of [`Continuation`][jaxcell.dynamics.Continuation]."""
    sentences = [
        f"Attractor {name} is {'; '.join(_runs(branches, name))}."
        for name in range(min(branches.attractors, _MOST))
    ]
    unsettled = np.flatnonzero(~branches.settled)
    settled = "All orbits have settled." if sentences else "No attractor was found."
    if unsettled.size:
        where = _listed([branches.parameters[k] for k in unsettled])
        settled = f"For {where}, {_UNSETTLED}."
    return (*sentences, *_more(branches.attractors), settled)


def described(basins: Any, k: int) -> str:
    """Describe attractor `k`: its kind, its period and its place."""
    kind, point = kind_of(basins, k), _coordinates(basins.point[k])
    names = _coordinates(basins.names)
    if kind == "point":
        return f"a point at {names} = {point}"
    between = (
        f"with {names} from {_coordinates(basins.lower[k])} to {_coordinates(basins.upper[k])}"
    )
    if kind == "neither":
        return (
            f"no point or cycle that was found, such as a torus, chaos or a long cycle, {between}"
        )
    points = f" of {basins.period[k]} points" if basins.period[k] > 1 else ""
    time = basins.return_time
    period = f" of period {time[k]:.6g}" if time is not None and np.isfinite(time[k]) else ""
    cycle = f"a cycle{points}{period} through {names} = {point}"
    return cycle if basins.period[k] == 1 else f"{cycle}, {between}"


_UNSETTLED = "orbits have not settled, so that attractors may be smaller, or not exist"


def _runs(branches: Any, name: int) -> Iterator[str]:
    """Describe an attractor at both ends of each run of parameters with the same kind of it."""
    places = [
        (member, int(np.flatnonzero(label == name)[0]))
        for member, label in enumerate(branches.label)
        if name in label
    ]
    alike = [
        (member, basins := branches.members[member], k, kind_of(basins, k), int(basins.period[k]))
        for member, k in places
    ]
    begun = [
        n
        for n, one in enumerate(alike)
        if n == 0 or (one[0] != alike[n - 1][0] + 1) or one[3:] != alike[n - 1][3:]
    ]
    for first, after in zip(begun, [*begun[1:], len(alike)], strict=True):
        run = [
            (branches.parameters[n], described(basins, k))
            for n, basins, k, *_ in alike[first:after]
        ]
        (begin, at_begin), (end, at_end) = run[0], run[-1]
        if len({words for _, words in run}) > 1:
            yield f"{at_begin} for {begin}, which becomes {at_end} for {end}"
        else:
            yield f"{at_begin} for {begin}" + (f" to {end}" if len(run) > 1 else "")


def _more(attractors: int) -> list[str]:
    more = attractors - _MOST
    return [f"{more} more attractors are in the tables and files."] if more > 0 else []


def _listed(texts: list[str]) -> str:
    shown = texts[:3]
    more = len(texts) - len(shown)
    return " and ".join([", ".join(shown), *([f"{more} more parameters"] if more else [])])


def _coordinates(values: Any) -> str:
    words = [value if isinstance(value, str) else f"{value:.4g}" for value in values]
    return words[0] if len(words) == 1 else f"({', '.join(words)})"
