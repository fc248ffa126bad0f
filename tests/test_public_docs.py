"""Every public name has a docstring, and functions have arguments, returns and an example."""

import ast
import functools
import importlib
import inspect
from pathlib import Path

import pytest


PACKAGES = [
    "automata",
    "bounce",
    "currents",
    "drift",
    "dynamics",
    "mapping",
    "markov",
    "optimize",
    "patrol",
    "patrol.map",
    "patrol.walks",
    "record",
    "robot",
    "space",
    "sweep",
]
# The least number of lines in the docstring of a package, which defines its mathematics.
A_PAGE = 25


@functools.cache
def public(package: str) -> dict[str, object]:
    """The exports of a package that can have a docstring."""
    module = importlib.import_module(f"jaxcell.{package}")
    path = Path(module.__file__)
    # Packages that import their modules lazily list their names in a stub.
    stub = path.with_suffix(".pyi")
    source = ast.parse((stub if stub.exists() else path).read_text(encoding="utf-8"))
    names = [
        alias.asname or alias.name
        for node in ast.walk(source)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
    ]
    values = {name: getattr(module, name) for name in names if not name.startswith("_")}
    return {name: value for name, value in values.items() if is_documented(value)}


def is_documented(value: object) -> bool:
    """Return whether a value can have a docstring: constants and aliases of types cannot."""
    return inspect.isclass(value) or inspect.ismodule(value) or is_function(value)


def is_function(value: object) -> bool:
    """Return whether a value is a function, also one transformed by JAX."""
    return inspect.isfunction(inspect.unwrap(value))


def docstring(value: object) -> str:
    """The docstring of a value, empty where a dataclass has only its signature."""
    text = inspect.getdoc(value) or ""
    if inspect.isclass(value) and text.startswith(f"{value.__name__}("):
        return ""
    return text


def lacks(value: object) -> list[str]:
    """The parts that a docstring lacks."""
    text = docstring(value)
    if not text:
        return ["a docstring"]
    if not is_function(value):
        return []
    signature = inspect.signature(inspect.unwrap(value))
    wanted = []
    if signature.parameters:
        wanted.append("**Arguments:**")
    if signature.return_annotation is not None:
        wanted.append("**Returns:**")
    return [part for part in [*wanted, ">>> "] if part not in text]


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_documented(package):
    missing = {name: parts for name, value in public(package).items() if (parts := lacks(value))}
    assert not missing


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_hides_a_public_name_from_the_reference(package):
    folder = Path(importlib.import_module(f"jaxcell.{package}").__file__).parent
    modules = {path.stem for path in folder.iterdir()}
    functions = {name for name, value in public(package).items() if not inspect.ismodule(value)}
    assert not modules & functions, "a file named as a function hides it: name it by its subject"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_begins_with_its_mathematics(package):
    module = importlib.import_module(f"jaxcell.{package}")
    text = inspect.getdoc(module) or ""
    assert len(text.splitlines()) >= A_PAGE
    functions = [name for name, value in public(package).items() if is_function(value)]
    unnamed = [name for name in functions if f"`{name}`" not in text]
    assert not unnamed, "the docstring of a package names each of its functions"
