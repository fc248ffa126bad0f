"""Prepare JAX and the import path for a command."""

import contextlib
import os
import sys
from collections.abc import Iterator

from ..base.process import signals_deferred
from ..base.runtime import program_cache
from .terminal import status


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Configure JAX for a command, and show a status during imports that take seconds."""
    with status("loading JAX"):
        from ..base.runtime import configure_jax

        configure_jax()
        yield
        # Here JAX starts a thread that would end only after a minute if a signal came before the
        # line that cancels it.
        import jax

        with signals_deferred():
            jax.devices()


def prepare_tasks() -> None:
    """Make tasks in the working folder importable, and configure JAX for when it is imported."""
    for name, value in {"jax_enable_x64": 1, **program_cache()}.items():
        os.environ.setdefault(name.upper(), str(value))
    sys.path.append(os.getcwd())
