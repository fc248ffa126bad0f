"""64-bit numbers, which probabilities and solves need and JAX gives only on request."""

import jax
import numpy as np


def require_x64(what: str) -> None:
    """Refuse to go on where JAX would silently compute with 32 bits."""
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise RuntimeError(
            f"{what} needs 64-bit numbers, and JAX is set to 32 bits: call "
            'jax.config.update("jax_enable_x64", True) first, or set JAX_ENABLE_X64=1'
        )
