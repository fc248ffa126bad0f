"""Convert and check arguments by the annotations of a function.

A class may have a method `of_input` that makes an object of what people have: a matrix or a graph
of networkx, for example. Errors name the function and the argument, and say what was expected.
"""

import collections.abc
import enum
import functools
import inspect
import os
import types
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

from .wide import OnHostError, traced


# Advice of errors to make an object of a class.
_ADVICE = {
    "Box": "; Box([0, -1], [1, 1], cells=[100, 200]) makes one",
    "CellSpace": "; CellSpace.of(map, cell, directions) makes one",
    "Dataset": "; open_currents(path) makes one of a file, and record.dataset(result) of a result",
    "Filter": "; localization_filter(simple_map) makes one",
    "Graph": "; a graph of networkx or an array of edges is one",
    "Result": "; the method run of a study returns one",
    "SimpleMap": "; bounce_map(cells, bounce) makes one",
    "Spec": "; Spec.load(path) makes one",
    "Chain": "; a square matrix (NumPy, SciPy, JAX, pandas, lists), a graph of networkx with "
    "probabilities as weights, and sequence.unrolled are chains",
    "PersistentGroups": "; persistent_groups(chain) finds them",
    "Generator": "; numpy.random.default_rng() makes one",
    "DecisionModel": "; DecisionModel.of(chains, reward) makes one",
}

# A protocol cannot have a method `of_input`, because it would be part of the protocol.
CONVERTERS: dict[type, Callable[[Any], Any]] = {}
"""Functions that make objects of a protocol of what people have."""


def checked(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Wrap the function `name` so that it converts its arguments to the types of its annotations.

    Other arguments raise `ValueError`. The types are classes of the library, sequences of them,
    arrays, paths, whole numbers, and numbers. Lists become arrays, and whole numbers of NumPy and
    JAX become those of Python.
    """
    signature = inspect.signature(function)
    checks: dict[str, Callable[[Any], Any]] = {
        argument: functools.partial(check, f"{name}: {argument}")
        for argument, parameter in signature.parameters.items()
        if (check := _check_of(parameter.annotation))
    }

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        given = tuple(zip(signature.parameters, args, strict=False))
        args = tuple(_checked(checks, *one) for one in given) + args[len(given) :]
        return function(*args, **{name: _checked(checks, name, options[name]) for name in options})

    return call


def check_methods(kind: type) -> None:
    """Let the public methods of a class that need no object check arguments as [`checked`][]."""
    for name, value in list(vars(kind).items()):
        if isinstance(value, classmethod | staticmethod) and not name.startswith(("_", "tree_")):
            method = checked(value.__func__, f"{kind.__name__}.{name}")
            setattr(kind, name, type(value)(method))


def _checked(checks: dict[str, Callable[[Any], Any]], name: str, value: Any) -> Any:
    return checks[name](value) if name in checks else value


def _check_of(annotation: Any) -> Callable[[str, Any], Any] | None:
    if isinstance(annotation, type) and annotation in CONVERTERS:
        return lambda _, value: CONVERTERS[annotation](value)
    kinds = typing.get_args(annotation) if _is_union(annotation) else (annotation,)
    own = tuple(kind for kind in kinds if _is_own(kind))
    if own and all(kind in own or kind is type(None) for kind in kinds):
        return functools.partial(_check_class, kinds)
    if typing.get_origin(annotation) is collections.abc.Sequence and all(
        map(_is_own, kinds[0].__args__)
    ):
        return functools.partial(_check_sequence, kinds[0].__args__[0])
    if set(kinds) == {str, os.PathLike[str]}:
        return _check_path
    if any(map(_is_array, kinds)) and all(_is_array(one) or one is type(None) for one in kinds):
        masks = all(kind.__name__.startswith("Bool[") for kind in kinds)
        return functools.partial(_check_array, _fallbacks(kinds), masks)
    # A number that may be traced has the type of an array without axes, too.
    plain = tuple(kind for kind in kinds if getattr(kind, "dim_str", None) != "")
    if set(plain) <= {int, float, type(None)} and plain != (type(None),):
        return functools.partial(_check_number, plain, plain != kinds)
    return None


def _is_union(annotation: Any) -> bool:
    return typing.get_origin(annotation) in (types.UnionType, typing.Union)


def _is_own(kind: Any) -> bool:
    """Check for classes whose objects are made by functions, not written as numbers or lists."""
    if isinstance(kind, type) and kind.__module__.startswith("jaxcell."):
        return not (issubclass(kind, enum.Enum) or getattr(kind, "_is_protocol", False))
    # A dataset is recognized by its name, because not everybody has xarray.
    return kind is np.random.Generator or f"{kind}" == "<class 'xarray.core.dataset.Dataset'>"


def _is_array(kind: Any) -> bool:
    return kind is np.ndarray or getattr(kind, "dim_str", "") != ""


def _check_class(kinds: Any, name: str, value: Any) -> Any:
    if isinstance(value, kinds):
        return value
    for kind in kinds:
        if hasattr(kind, "of_input") and (made := kind.of_input(value)) is not None:
            return made
    names = [kind.__name__ for kind in kinds if kind is not type(None)]
    advice = _ADVICE.get(names[0], "")
    article = "an" if names[0][0] in "AEIO" else "a"
    got = f"{type(value).__name__}{advice}"
    raise ValueError(f"{name}: expected {article} {' or '.join(names)}, got {got}")


def _check_sequence(kind: type, name: str, value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise ValueError(f"{name}: expected a list of {kind.__name__}s, got {type(value).__name__}")
    parts = [_check_class((kind,), f"{name}[{place}]", part) for place, part in enumerate(value)]
    return tuple(parts) if isinstance(value, tuple) else parts


def _check_path(name: str, value: Any) -> Any:
    if isinstance(value, str | os.PathLike):
        return value
    raise ValueError(f"{name}: expected a path, got {type(value).__name__}")


def _fallbacks(kinds: tuple[Any, ...]) -> tuple[type, ...]:
    """Return the types of values besides arrays: `None`, and numbers for arrays of any shape."""
    any_shape = any(dim in getattr(kind, "dim_str", "") for kind in kinds for dim in ("*", "..."))
    return (*(kind for kind in kinds if kind is type(None)), *((int, float) * any_shape))


def _check_array(fallbacks: Any, masks: bool, name: str, value: Any) -> Any:
    if hasattr(value, "shape") or isinstance(value, fallbacks):
        return value
    try:
        array = np.asarray(value, None if isinstance(value, list | tuple | range) else object)
    except ValueError:
        raise ValueError(f"{name}: expected an array, got lists of different lengths") from None
    if array.dtype.kind not in "biufc":
        raise ValueError(f"{name}: expected an array of numbers, got {type(value).__name__}")
    if masks and not np.isin(array, (0, 1)).all():
        raise ValueError(f"{name}: expected an array of True and False, got {array.dtype}")
    return array.astype(bool) if masks else array


def _check_number(kinds: Any, may_trace: bool, name: str, value: Any) -> Any:
    if value is None and type(None) in kinds:
        return value
    noun = "number" if float in kinds else "whole number"
    if not may_trace and traced(value):
        raise OnHostError(
            f"{name}: expected a {noun}, got one that JAX traces; it is read on the host, outside "
            "jit, vmap and grad"
        )
    kind = getattr(getattr(value, "dtype", None), "kind", None)
    if kind is None:
        kind = {bool: "b", int: "i", float: "f"}.get(type(value), "O")
    if kind == "f" and float not in kinds and not np.ndim(value) and float(value).is_integer():
        return int(value)
    if kind not in ("biuf" if float in kinds else "biu") or np.ndim(value):
        raise ValueError(f"{name}: expected a {noun}, got {value!r}")
    # Whole numbers become parts of programs, and arrays of JAX have no hash.
    return int(value) if kind in "iu" and not may_trace else value
