"""Short texts, HTML and plots of the objects that public functions return; names of modules."""

import dataclasses
import importlib
import reprlib
import textwrap
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Largest size of an array whose numbers are shown, and number of parts of a tuple.
_NUMBERS, _PARTS = 8, 4
_LINES, _WIDTH = 5, 100


class Shown:
    """The base class of dataclasses that have a short text, and HTML for notebooks."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # By default a dataclass prints all numbers of its arrays.
        cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """List the fields; of a large array, the type and the shape."""
        fields = ", ".join(f"{name}={text}" for name, text in field_texts(self).items())
        text = f"{type(self).__name__}({fields})"
        lines = textwrap.wrap(text, _WIDTH, subsequent_indent="    ", break_on_hyphens=False)
        cut = [*lines[: _LINES - 1], f"{lines[_LINES - 1]} ..."] if lines[_LINES:] else lines
        return "\n".join(cut)

    def _repr_html_(self) -> str:
        """Describe the object as HTML for a notebook."""
        return str(figures("html").html(self))


class Pictured(Shown):
    """The base class of dataclasses that also have a plot."""

    def plot(
        self, name: str | None = None, *, ax: "Axes | None" = None, on: Any = None, **options: Any
    ) -> "Axes":
        """Draw the object, or one of its arrays, with matplotlib.

        The arguments are those of [`jaxcell.record.plot`][].
        """
        axes: Axes = figures("plot").plot(self, name, ax=ax, on=on, **options)
        return axes


def own_names(module: Mapping[str, Any]) -> list[str]:
    """Return the public names of the functions and classes that a module defines."""
    own, public = module["__name__"], (name for name in module if name[0] != "_")
    return [name for name in public if getattr(module[name], "__module__", "") == own]


def figures(module: str) -> ModuleType:
    """Import a module of `jaxcell.record.figures` on demand, because it imports this module."""
    return importlib.import_module(f"jaxcell.record.figures.{module}")


def field_texts(value: Any) -> dict[str, str]:
    """Describe each field of a dataclass in a few words, keyed by its name."""
    return {
        field.name: _text(getattr(value, field.name))
        for field in dataclasses.fields(value)
        if field.repr and not field.name.startswith("_")
    }


def _text(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return _array_text(value)
    if isinstance(value, tuple | list):
        if len(value) > _PARTS:
            return f"{type(value).__name__} of {len(value):,}"
        texts = ", ".join(map(_text, value))
        return f"[{texts}]" if isinstance(value, list) else f"({texts})"
    if dataclasses.is_dataclass(value):
        return repr(value)
    return getattr(value, "__qualname__", "") or reprlib.repr(value)


def _array_text(array: Any) -> str:
    from .wide import traced

    if traced(array) or not hasattr(array, "__array__") or array.size > _NUMBERS:
        return f"{array.dtype}[{', '.join(map(str, array.shape))}]"
    import numpy as np

    numbers = np.asarray(array)
    return np.array2string(numbers, precision=6, separator=", ").replace("\n", "")
