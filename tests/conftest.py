import contextlib
import functools
import gc
import os
import tempfile
from pathlib import Path

import hypothesis
import jax
import pytest

from jaxcell.base.runtime import compile_quickly


# JAX makes many objects: collecting garbage at the usual rate takes 8 % of the time.
gc.set_threshold(10_000, 10, 10)

# `make test` draws a few cases of each property, always the same ones; `make test-all` draws five
# times as many, at random.
hypothesis.settings.register_profile("quick", deadline=None, max_examples=20, derandomize=True)
hypothesis.settings.register_profile("whole", deadline=None, max_examples=100)
hypothesis.settings.load_profile("quick")

jax.config.update("jax_enable_x64", os.environ.get("JAX_ENABLE_X64") != "0")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
# Tests spend most of their time in compilation. Programs without optimization compile in a third of
# the time, and are slower; `make test-all` optimizes. Processes and later runs share programs.
compile_quickly("--xla_backend_optimization_level=0", "--xla_cpu_parallel_codegen_split_count=1")
_CACHE = Path(__file__).parents[1] / ".pytest_cache" / "xla"
with contextlib.suppress(OSError):
    _CACHE.mkdir(parents=True, exist_ok=True)
if not os.access(_CACHE, os.W_OK):
    _CACHE = Path(tempfile.gettempdir()) / f"jaxcell-xla-{os.getuid()}"
jax.config.update("jax_compilation_cache_dir", str(_CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def pytest_configure(config):
    # Many small files of the tests deserve a doubt; tests of doubts use `pytest.warns`.
    config.addinivalue_line("filterwarnings", "ignore::jaxcell.base.doubts.Doubt")


def pytest_sessionfinish():
    # A process that ends needs no garbage collection.
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """Use one BLAS thread: parallel tests leave no core to threads that wait by spinning."""
    from jaxcell.base.process import one_blas_thread

    with one_blas_thread():
        yield


@pytest.fixture(autouse=True, scope="session")
def commands_of_tests():
    """Make the output of commands independent of the speed of the machine; keep JAX as above."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxcell.cli.terminal.FIRST_LINE", 3600.0)
        patch.setattr("jaxcell.base.runtime.configure_jax", lambda: None)
        yield


@pytest.fixture
def without_flags():
    """JAX uses 32 bits, as in the program of a user who sets nothing."""
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", False)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture(scope="module")
def few_drifters():
    """Maps are compared with 4 drifters from each cell, in place of 36, and 1,000 of releases."""
    from jaxcell.drift.validation import distance, release

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(distance, "SAMPLING", distance.Sampling(most=2))
        patch.setattr(release, "_SAMPLING", distance.Sampling(drifters=1000, most=1000))
        yield


@pytest.fixture
def patient(monkeypatch):
    """Commands wait for an emulated robot on a line that a busy machine makes late."""
    from jaxcell.robot import Create

    monkeypatch.setattr(Create, "open", functools.partial(Create.open, patience=5.0))


@pytest.fixture
def getkey():
    """A function that gives a new PRNG key at each call."""
    key = jax.random.key(0)

    def next_key():
        nonlocal key
        key, new = jax.random.split(key)
        return new

    return next_key
