"""How many threads linear algebra takes."""

import contextlib
import functools
from collections.abc import Iterator

from threadpoolctl import ThreadpoolController


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to one thread.

    Factors of some hundreds of rows gain nothing from a second one. Threads of OpenBLAS wait for
    each other by spinning, so that where anything else runs, JAX in the same process included, they
    take up to twenty times as long.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _controller() -> ThreadpoolController:
    # It knows the libraries that are loaded when it is made.
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()
