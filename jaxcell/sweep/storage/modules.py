"""Find the files of the user's modules that a task imports."""

import ast
import pkgutil
import sys
import sysconfig
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from importlib.util import resolve_name
from pathlib import Path


_INSTALLED = ("site-packages", "dist-packages")
_STANDARD = Path(sysconfig.get_path("stdlib"))
_OURS = __name__.partition(".")[0]


def module_file(name: str) -> Path | None:
    """Find the file of a module without importing it; `None` if no file defines it."""
    return _found(name)[0]


def is_users(module: str, file: Path) -> bool:
    """Return whether a module is the user's, not from Python, an installed package, or jaxcell."""
    installed = _STANDARD in file.parents or any(part in _INSTALLED for part in file.parts)
    return module.partition(".")[0] != _OURS and not installed


def imported_files(path: Path, name: str = "") -> dict[str, Path]:
    """Find the files of the user's modules that a file imports, directly or indirectly.

    The files are parsed, not run: imports inside functions are found, but imports whose names are
    computed are not. `name` is the module name of the file, or empty for a script. Returns the
    files, keyed by the names of their modules.
    """
    files: dict[str, Path] = {}
    todo = list(_imported(path, name))
    while todo:
        module = todo.pop()
        file = None if module in files else module_file(module)
        if file is not None and file != path and is_users(module, file):
            files[module] = file
            todo += _imported(file, module)
    return dict(sorted(files.items()))


def _imported(path: Path, name: str) -> Iterator[str]:
    """Yield the names of modules that a file may import, and of the packages that contain them."""
    parts = name.split(".")
    yield from (".".join(parts[:count]) for count in range(1, len(parts)))
    package = name if path.stem == "__init__" else name.rpartition(".")[0]
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError, RecursionError):
        # An extension module, or a file that Python cannot import either.
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                yield from _with_parents(one.name)
        elif isinstance(node, ast.ImportFrom):
            try:
                source = resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:
                continue
            yield from _with_parents(source)
            # An imported name may be a module of the package; * may be all of them.
            names = [one.name for one in node.names]
            yield from (f"{source}.{one}" for one in (_members(source) if "*" in names else names))


def _with_parents(module: str) -> Iterator[str]:
    parts = module.split(".")
    return (".".join(parts[:count]) for count in range(1, len(parts) + 1))


def _members(package: str) -> list[str]:
    folders = _found(package)[1]
    return [path.stem for folder in folders for path in sorted(Path(folder).glob("*.py"))]


def _found(name: str) -> tuple[Path | None, list[str]]:
    """Find the file of a module (or `None`), and the folders that contain its submodules."""
    parent, _, _ = name.rpartition(".")
    if not parent:
        specs = (finder.find_spec(name, None) for finder in sys.meta_path)
        return _described(next(filter(None, specs), None))
    inside: list[str] = []
    for folder in _found(parent)[1]:
        finder = pkgutil.get_importer(folder)
        file, folders = _described(None if finder is None else finder.find_spec(name))
        if file is not None:
            return file, folders
        inside += folders
    return None, inside


def _described(spec: ModuleSpec | None) -> tuple[Path | None, list[str]]:
    if spec is None:
        return None, []
    path = Path(spec.origin or "")
    file = path if spec.has_location and path.is_file() else None
    return file, [*(spec.submodule_search_locations or [])]
