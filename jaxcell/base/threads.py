"""Limit the threads of linear algebra."""

import contextlib
import functools
from collections.abc import Iterator

from threadpoolctl import ThreadpoolController


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to one thread.

    Factorizations of some hundred rows gain nothing from a second thread. Threads of OpenBLAS wait
    by spinning, so they take up to twenty times as long if JAX or another process runs too.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _controller() -> ThreadpoolController:
    # The controller knows only libraries that were loaded before it was made.
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()
