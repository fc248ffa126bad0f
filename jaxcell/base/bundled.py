"""Bundled data: maps, graphs, ocean currents and drifters, and specifications of sweeps."""

import functools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from .formatting import did_you_mean


# The ends of the names of the files that have a name, by folder.
_KINDS = {
    "maps": (".json", ".txt", ".yaml"),
    "graphs": (".json",),
    "ocean": (".nc", "gdp.npz"),
    "sweeps": (".toml",),
}


def bundled(name: str) -> Path:
    """Find a bundled file by its name, or by its path in the data folder.

    Examples are `lab_a`, `@lab_a` and `maps/lab_a.json`; `jaxcell maps` lists the names. On the
    command line and in specifications of sweeps, names begin with `@`. The data folder is `data` in
    a checkout or in an installed package. **Raises:** `FileNotFoundError` for an unknown name.

        >>> from jaxcell import bundled
        >>> bundled("lab_a") == bundled("maps/lab_a.json")
        True
    """
    names = bundled_names()
    if (path := names.get(name.removeprefix("@"))) is not None:
        return path
    if (path := _folder() / name).is_file():
        return path
    known = [f"@{one}" for one in names] if name.startswith("@") else names
    meant = did_you_mean(name.lower(), known) or "; `jaxcell maps` lists their names"
    raise FileNotFoundError(f"{name}: not among the bundled data of jaxcell{meant}")


@functools.cache
def bundled_names() -> Mapping[str, Path]:
    """Return the path of each file of the bundled data, keyed by its name without suffix."""
    return MappingProxyType(
        {
            path.stem: path
            for folder, suffixes in _KINDS.items()
            for path in sorted((_folder() / folder).iterdir())
            if path.name.endswith(suffixes)
        }
    )


def with_path(argument: str) -> str:
    """Return the path of a bundled file such as `@lab_a`; return other arguments unchanged."""
    return str(bundled(argument)) if argument.startswith("@") else argument


def _folder() -> Path:
    package = Path(__file__).parents[1]
    inside = package / "data"
    return inside if inside.is_dir() else package.parent / "data"
