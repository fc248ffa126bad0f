import os

import jax
import pytest


jax.config.update("jax_enable_x64", os.environ.get("JAX_ENABLE_X64") != "0")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def getkey():
    """A function that gives a new PRNG key at each call."""
    key = jax.random.key(0)

    def next_key():
        nonlocal key
        key, new = jax.random.split(key)
        return new

    return next_key
