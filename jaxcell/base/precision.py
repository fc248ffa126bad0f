"""Require 64-bit numbers for probabilities and solvers, because JAX uses 32 bits by default."""

import jax
import numpy as np


def require_x64(what: str) -> None:
    """Raise `RuntimeError` if JAX uses 32-bit numbers; `what` names the computation."""
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise RuntimeError(
            f"{what} needs 64-bit numbers, and JAX is set to 32 bits: call "
            'jax.config.update("jax_enable_x64", True) first, or set JAX_ENABLE_X64=1'
        )
