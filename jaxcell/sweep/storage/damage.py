"""Report that the folder of a sweep is damaged, instead of the errors that the damage causes."""

import contextlib
import shlex
from collections.abc import Iterator
from pathlib import Path

from ...base.documents import NewerVersionError


class DamageError(ValueError):
    """The folder of a sweep is damaged."""


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Convert errors in a `with` block to a `DamageError`, with advice how to mend the sweep."""
    try:
        yield
    except (OSError, DamageError):
        raise  # They name their file.
    except NewerVersionError as error:
        raise NewerVersionError(f"{folder}: {error}") from None
    except Exception as error:  # Zarr and msgspec have errors of many types.
        message = " ".join(str(error).split())[:500]
        reason = f"{type(error).__name__}: {message}" if message else type(error).__name__
        raise DamageError(
            f"{folder}: the sweep there is damaged: {reason}; to mend it: "
            f"jaxcell verify --mend {shlex.quote(str(folder))}"
        ) from error
