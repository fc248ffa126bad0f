"""Check arguments by the annotations of a function, for errors that say what was expected."""

import collections.abc
import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any

import numpy as np


# Advice of errors to make an object of a class.
_ADVICE = {
    "Chain": "; Chain.from_scipy(matrix) makes one, and sequence.unrolled is one",
    "PersistentGroups": "; persistent_groups(chain) finds them",
    "Generator": "; numpy.random.default_rng() makes one",
    "DecisionModel": "; DecisionModel.of(chains, reward) makes one",
}


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function so that arguments of other types than its annotations raise `ValueError`.

    It checks classes of the library, sequences of them, whole numbers, and numbers.
    """
    signature = inspect.signature(function)
    checks = {
        name: check
        for name, parameter in signature.parameters.items()
        if (check := _check_of(parameter.annotation))
    }

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        for name, value in (*zip(signature.parameters, args, strict=False), *options.items()):
            if name in checks:
                checks[name](name, value)
        return function(*args, **options)

    return call


def _check_of(annotation: Any) -> Callable[[str, Any], None] | None:
    kinds = typing.get_args(annotation) if _is_union(annotation) else (annotation,)
    own = tuple(kind for kind in kinds if _is_own(kind))
    if own and all(kind in own or kind is type(None) for kind in kinds):
        return functools.partial(_check_class, kinds)
    if typing.get_origin(annotation) is collections.abc.Sequence and all(
        map(_is_own, kinds[0].__args__)
    ):
        return functools.partial(_check_sequence, kinds[0].__args__[0])
    # A number may be traced, too.
    kinds = tuple(kind for kind in kinds if getattr(kind, "dim_str", None) != "")
    if set(kinds) <= {int, float, type(None)} and kinds != (type(None),):
        return functools.partial(_check_number, kinds)
    return None


def _is_union(annotation: Any) -> bool:
    return typing.get_origin(annotation) in (types.UnionType, typing.Union)


def _is_own(kind: Any) -> bool:
    """Check for classes whose objects are made by functions, not written as numbers or lists."""
    if dataclasses.is_dataclass(kind):
        return kind.__module__.startswith("jaxcell.")
    return kind is np.random.Generator


def _check_class(kinds: tuple[type, ...], name: str, value: Any) -> None:
    if not isinstance(value, kinds):
        names = [kind.__name__ for kind in kinds if kind is not type(None)]
        advice = _ADVICE.get(names[0], "")
        raise ValueError(
            f"{name}: expected a {' or '.join(names)}, got {type(value).__name__}{advice}"
        )


def _check_sequence(kind: type, name: str, value: Any) -> None:
    if not isinstance(value, list | tuple):
        raise ValueError(f"{name}: expected a list of {kind.__name__}s, got {type(value).__name__}")
    for place, part in enumerate(value):
        _check_class((kind,), f"{name}[{place}]", part)


def _check_number(kinds: tuple[type, ...], name: str, value: Any) -> None:
    if value is None and type(None) in kinds:
        return
    kind = getattr(getattr(value, "dtype", None), "kind", None)
    if kind is None:
        kind = {bool: "b", int: "i", float: "f"}.get(type(value), "O")
    if kind not in ("biuf" if float in kinds else "biu") or np.ndim(value):
        noun = "number" if float in kinds else "whole number"
        raise ValueError(f"{name}: expected a {noun}, got {value!r}")
