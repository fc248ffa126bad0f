"""Report that the folder of a sweep is damaged, instead of the errors that the damage causes."""

import contextlib
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Convert errors in a `with` block to a `ValueError`, which says that the sweep is damaged."""
    try:
        yield
    except Exception as error:  # Zarr and msgspec have errors of many types.
        message = " ".join(str(error).split())[:500]
        if isinstance(error, ValueError | OSError) and str(folder) in message:
            raise
        reason = f"{type(error).__name__}: {message}" if message else type(error).__name__
        raise ValueError(
            f"{folder}: the sweep there is damaged: {reason}; to mend it: "
            f"jaxcell sweep verify {folder}"
        ) from error
