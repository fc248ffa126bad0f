"""Refuse to trace probabilities and solvers into a program of JAX with 32 bits."""

import jax
import numpy as np


def has_x64() -> bool:
    """Return whether JAX uses 64-bit numbers here."""
    return bool(jax.dtypes.canonicalize_dtype(np.float64) == np.float64)


def require_x64(what: str) -> None:
    """Raise `RuntimeError` if JAX uses 32-bit numbers; `what` names the computation."""
    if not has_x64():
        raise RuntimeError(
            f"{what} needs 64-bit numbers, and jit, vmap or grad traces it with 32 bits: call "
            'jax.config.update("jax_enable_x64", True) before it'
        )
