"""Parts of a result whose quantities are quantities of the result, too."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar, get_args

from ...base.quantities import from_part, quantities


_Part = TypeVar("_Part")


def flattened(prefix: str = "") -> "Callable[[Callable[[Any], _Part]], _Flattened[_Part]]":
    """Decorate a method that computes a part of a result, once, at the first use.

    The annotation of the method names the class of the part, as in `Part` or `Part | None`. Each
    quantity of the part becomes a quantity of the result, whose name begins with `prefix`.
    """
    return lambda method: _Flattened(method, prefix)


class _Flattened(functools.cached_property[_Part]):
    def __init__(self, method: Callable[[Any], _Part], prefix: str) -> None:
        super().__init__(method)
        self.prefix = prefix

    def __set_name__(self, owner: type[Any], name: str) -> None:
        super().__set_name__(owner, name)
        returned = self.func.__annotations__["return"]
        kind = next(iter(get_args(returned)), returned)
        for key, about in quantities(kind).items():
            described = " ".join(about.dims), about.meaning, about.units
            more = {"kind": about.kind, "listed": about.listed, **about.attributes}
            quantity = from_part(f"{name}.{key}", *described, **more)
            setattr(owner, self.prefix + key, quantity)
            quantity.__set_name__(owner, self.prefix + key)
