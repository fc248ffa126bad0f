"""The data that come with the library: maps, graphs and a small sea."""

from pathlib import Path


def bundled(name: str) -> Path:
    """A file of the bundled data, such as `maps/lab_a.json`.

    In a checkout it lies in `data`, in an installed package inside the package.

    **Raises:** `FileNotFoundError` if there is no such file.
    """
    package = Path(__file__).parents[1]
    for folder in (package / "data", package.parent / "data"):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"{name}: not among the bundled data of {package}")
