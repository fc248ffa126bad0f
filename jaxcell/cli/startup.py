"""Prepare JAX and the import path for a command."""

import contextlib
import os
import sys
from collections.abc import Iterator

from .terminal import status


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Configure JAX for a command, and show a status during imports that take seconds."""
    with status("loading JAX"):
        from ..base.runtime import configure_jax

        configure_jax()
        yield


def prepare_tasks() -> None:
    """Make modules in the working folder importable as tasks, and set JAX to 64 bits.

    JAX is not imported, because tasks may not need it.
    """
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    sys.path.append(os.getcwd())
