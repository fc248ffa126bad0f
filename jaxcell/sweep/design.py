"""Parameters of a sweep: grids, lists and random samples, read from a specification."""

import dataclasses
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np


LIST_DIMENSION = "member"
RANDOM_DIMENSION = "sample"

# A parameter `status` would replace the variable `status` of results.
_RESERVED = (LIST_DIMENSION, RANDOM_DIMENSION, "status")
_MAX_VALUES = 10_000_000
# Largest accepted number. The difference of two such numbers is finite.
_LARGEST = 1e300
# A range ends before its stop, even if rounding left the last value slightly below the stop.
_STEP_TOLERANCE = 1e-9
SALTELLI = "saltelli"
_DESIGNS = ("sobol", "latin_hypercube", SALTELLI)
_RANDOM_FIELDS = ("samples", "design")
# A normal distribution has no quantiles of 0 and 1.
_EDGE = 2.0**-53


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter and its values along one dimension."""

    name: str
    dimension: str
    "The parameter's name if it is in a grid; `member` in a list; `sample` for random samples."
    values: np.ndarray
    "A one-dimensional array of 64-bit integers or floats, booleans, or strings."

    @property
    def table(self) -> str:
        """The table of the specification that contains the parameter: grid, list or random."""
        return {LIST_DIMENSION: "list", RANDOM_DIMENSION: "random"}.get(self.dimension, "grid")


@dataclasses.dataclass(frozen=True)
class _Distribution:
    draw: Callable[[np.random.Generator, int], np.ndarray]
    "A function that draws a given number of independent samples."
    quantile: Callable[[np.ndarray], np.ndarray]
    "A function that computes quantiles at given probabilities: the median at 0.5."


def read_parameters(
    grid: Mapping[str, Any], listed: Mapping[str, Any], random: Mapping[str, Any], seed: int
) -> tuple[Parameter, ...]:
    """Read the parameters of `[grid]`, `[list]` and `[random]`, one table after the other.

    The page "Sweeps" of the documentation describes the tables. If `[random]` has no design, the
    samples of a parameter do not depend on the other parameters.
    """
    if listed and random:
        raise ValueError("[list] and [random]: expected only one of them, with or without a [grid]")
    parameters = [
        Parameter(name, name, _named(f"grid.{name}", _grid_values, given))
        for name, given in grid.items()
    ]
    lists = {name: _named(f"list.{name}", _list_values, given) for name, given in listed.items()}
    parameters += [Parameter(name, LIST_DIMENSION, values) for name, values in lists.items()]
    lengths = {name: values.size for name, values in lists.items()}
    if len(set(lengths.values())) > 1:
        given = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ValueError(f"[list]: expected lists of one length, got {given}")
    if random:
        parameters += _read_random(random, seed)
    for parameter in parameters:
        check_name(parameter.name)
    names = [parameter.name for parameter in parameters]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"{twice} is in two of the tables [grid], [list] and [random]")
    if not parameters:
        raise ValueError("no parameters; expected a table [grid], [list] or [random]")
    return tuple(parameters)


def check_name(name: str) -> None:
    if not name.isidentifier() or name in _RESERVED:
        reserved = ", ".join(_RESERVED)
        raise ValueError(
            f"{name!r}: expected a name of letters, digits and underscores, other than {reserved}"
        )


def _read_random(random: Mapping[str, Any], seed: int) -> list[Parameter]:
    samples = _count("random.samples", random.get("samples"))
    distributions = {
        name: _named(f"random.{name}", _distribution, given)
        for name, given in random.items()
        if name not in _RANDOM_FIELDS
    }
    if not distributions:
        raise ValueError("[random]: expected a distribution for at least one parameter")
    if "design" in random:
        points = _design_points(random["design"], len(distributions), samples, seed)
        columns = [
            one.quantile(column)
            for one, column in zip(distributions.values(), points.T, strict=True)
        ]
    else:
        columns = [
            one.draw(np.random.default_rng([seed, *name.encode()]), samples)
            for name, one in distributions.items()
        ]
    named = zip(distributions, columns, strict=True)
    return [Parameter(name, RANDOM_DIMENSION, values) for name, values in named]


def _design_points(design: Any, parameters: int, samples: int, seed: int) -> np.ndarray:
    """Generate the points of a sampling design in the unit cube, of shape `(members, parameters)`.

    For `sobol` and `saltelli`, a larger number of samples only appends points.
    """
    if design not in _DESIGNS:
        raise ValueError(
            f"random.design: expected one of {', '.join(_DESIGNS)}, got {reprlib.repr(design)}"
        )
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if design == "latin_hypercube":
        points = qmc.LatinHypercube(parameters, rng=rng).random(samples)
    else:
        if samples.bit_count() != 1:
            raise ValueError(
                f"random.samples: expected a power of 2 for the design {design}, got {samples}"
            )
        columns = parameters * (1 + (design == SALTELLI))
        points = qmc.Sobol(columns, bits=64, rng=rng).random(samples)
    if design == SALTELLI:
        if (members := samples * (parameters + 2)) > _MAX_VALUES:
            raise ValueError(
                f"random.samples: expected at most {_MAX_VALUES} members, got {members}"
            )
        a, b = np.split(points, 2, axis=1)
        mixed = np.where(np.eye(parameters, dtype=bool), b[:, None], a[:, None])
        points = np.concatenate([a[:, None], b[:, None], mixed], axis=1).reshape(-1, parameters)
    return np.clip(points, _EDGE, 1 - _EDGE)


def _named(field: str, read: Callable[[Any], Any], given: Any) -> Any:
    try:
        return read(given)
    except ValueError as error:
        raise ValueError(f"{field}: {error}") from None


def _grid_values(given: Any) -> np.ndarray:
    values = _range_values(given) if isinstance(given, Mapping) else _list_values(given)
    # Values must differ, because they are labels of the dimension, for example in `sel`.
    ordered = np.sort(values)
    if (ordered[1:] == ordered[:-1]).any():
        raise ValueError(f"expected different values, got {reprlib.repr(values.tolist())}")
    return values


def _list_values(given: Any) -> np.ndarray:
    if not isinstance(given, Sequence) or isinstance(given, str) or not given:
        raise ValueError(f"expected a list of values, got {reprlib.repr(given)}")
    if all(isinstance(value, bool | str) for value in given) and len(set(map(type, given))) == 1:
        return np.array(given)
    if not all(_number(value) for value in given):
        raise ValueError(
            f"expected finite numbers, or strings, or booleans, got {reprlib.repr(given)}"
        )
    if all(_whole(value) for value in given):
        if not all(-(2**63) <= value < 2**63 for value in given):
            raise ValueError(f"expected integers of 64 bits, got {reprlib.repr(given)}")
        return np.array(given, np.int64)
    return np.array(given, np.float64)


def _range_values(given: Mapping[str, Any]) -> np.ndarray:
    fields = set(given)
    if fields == {"count"}:
        return np.arange(_count("count", given["count"]), dtype=np.int64)
    if fields not in ({"start", "stop", "step"}, {"start", "stop", "num"}):
        raise ValueError(
            "expected a list, {start, stop, step}, {start, stop, num} or {count}, "
            f"got the fields {', '.join(sorted(fields)) or 'of an empty table'}"
        )
    for field in sorted(fields - {"num"}):
        if not _number(given[field]):
            raise ValueError(f"{field}: expected a finite number, got {reprlib.repr(given[field])}")
    start, stop = given["start"], given["stop"]
    if "num" in fields:
        return np.linspace(float(start), float(stop), _count("num", given["num"]))
    step = given["step"]
    parts = (stop - start) / step if step else 0
    if parts > _MAX_VALUES:
        raise ValueError(f"the number of values: expected at most {_MAX_VALUES}, got {parts:g}")
    count = math.ceil(max(parts, 0) - _STEP_TOLERANCE)
    if count < 1:
        raise ValueError(f"there are no values from {start} up to {stop} in steps of {step}")
    kind = np.int64 if all(map(_whole, given.values())) else np.float64
    if kind is np.int64 and not all(-(2**63) <= end < 2**63 for end in (start, stop, step)):
        raise ValueError(f"expected integers of 64 bits, got {reprlib.repr(given)}")
    return start + step * np.arange(count, dtype=kind)


def _count(field: str, given: Any) -> int:
    if not _whole(given) or not 0 < given <= _MAX_VALUES:
        raise ValueError(
            f"{field}: expected a number from 1 to {_MAX_VALUES}, got {reprlib.repr(given)}"
        )
    return given


def _distribution(given: Any) -> _Distribution:
    if not isinstance(given, Mapping) or len(given) != 1:
        raise ValueError(f"expected one of {_KINDS}, got {reprlib.repr(given)}")
    (kind, values), *_ = given.items()
    if kind == "choice":
        choices = _list_values(values)
        return _Distribution(
            lambda rng, samples: choices[rng.integers(choices.size, size=samples)],
            lambda points: choices[(points * choices.size).astype(np.int64)],
        )
    if kind not in ("uniform", "loguniform", "normal", "integers"):
        raise ValueError(f"expected one of {_KINDS}, got {kind!r}")
    if not isinstance(values, Sequence) or len(values) != 2 or not all(map(_number, values)):
        raise ValueError(f"{kind}: expected two finite numbers, got {reprlib.repr(values)}")
    a, b = values
    if kind == "normal":
        if b < 0:
            raise ValueError(f"normal: expected a deviation of at least 0, got {b}")
        return _Distribution(
            lambda rng, samples: rng.normal(a, b, samples), lambda points: a + b * _ndtri(points)
        )
    if not a <= b:
        raise ValueError(f"{kind}: expected a low and then a high end, got {a} and {b}")
    if kind == "integers":
        if not (_whole(a) and _whole(b) and max(-a - 1, b) < 2**63):
            raise ValueError(f"integers: expected integers of 64 bits, got {a} and {b}")
        return _Distribution(
            lambda rng, samples: rng.integers(a, b, samples, endpoint=True),
            # Integers of Python are exact for any width.
            lambda points: np.array([a + int(one * (b - a + 1)) for one in points], np.int64),
        )
    if kind == "loguniform":
        if not a > 0:
            raise ValueError(f"loguniform: expected positive ends, got {a} and {b}")
        low, high = math.log(a), math.log(b)
        return _Distribution(
            lambda rng, samples: np.exp(rng.uniform(low, high, samples)),
            lambda points: np.exp(low + (high - low) * points),
        )
    return _Distribution(
        lambda rng, samples: rng.uniform(a, b, samples), lambda points: a + (b - a) * points
    )


def _ndtri(points: np.ndarray) -> np.ndarray:
    from scipy.special import ndtri

    return ndtri(points)


_KINDS = "{uniform}, {loguniform}, {normal}, {integers} and {choice}"


def _whole(given: Any) -> bool:
    return isinstance(given, int) and not isinstance(given, bool)


def _number(given: Any) -> bool:
    return (_whole(given) or isinstance(given, float)) and abs(given) <= _LARGEST
