"""Run every example in a docstring of jaxcell."""

import doctest
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import jaxcell


ROOT = Path(jaxcell.__file__).parent
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def modules_with_examples() -> list[str]:
    """The modules with an example, without importing them."""
    names = []
    for path in sorted(ROOT.rglob("*.py")):
        if ">>> " in path.read_text(encoding="utf-8"):
            parts = ("jaxcell", *path.relative_to(ROOT).with_suffix("").parts)
            names.append(".".join(parts).removesuffix(".__init__"))
    return names


def examples(module: ModuleType) -> Iterator[doctest.DocTest]:
    """The examples of the docstring of a module, and of its functions and classes.

    Each begins without names, so that a reader can paste it into a prompt. The finder does not get
    the module, because it would skip functions that the run-time type checks wrap.
    """
    finder = doctest.DocTestFinder(exclude_empty=True)
    own = doctest.DocTestParser().get_doctest(
        module.__doc__ or "", {}, module.__name__, module.__file__, 0
    )
    yield own
    seen = set()
    for name, value in list(vars(module).items()):
        if getattr(value, "__module__", None) != module.__name__:
            continue
        # A transformed function has the examples of the function.
        inner = inspect.unwrap(value)
        if inner not in seen and (inspect.isclass(inner) or inspect.isroutine(inner)):
            seen.add(inner)
            yield from finder.find(value, f"{module.__name__}.{name}", module=False, globs={})


@pytest.mark.usefixtures("without_flags")
@pytest.mark.parametrize("name", modules_with_examples())
def test_examples(name):
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("jaxcell"):
            raise
        pytest.skip(f"needs the optional {error.name}")
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    report: list[str] = []
    for test in examples(module):
        runner.run(test, out=report.append)
    assert not runner.failures, "".join(report)
    prompts = re.findall(r"^\s*>>> ", Path(module.__file__).read_text(encoding="utf-8"), re.M)
    assert runner.tries == len(prompts), "an example did not run"
