"""How a program of ours starts JAX; a library that uses jaxcell decides that for itself."""

import os
from pathlib import Path

import jax


def configure_jax() -> None:
    """Turn on 64-bit numbers, and a compilation cache in a private directory of the user.

    The cache runs what it finds, so nobody else may write there. Where no such directory can be
    made, there is no cache.
    """
    jax.config.update("jax_enable_x64", True)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    directory = Path(home) / "jaxcell" / "xla"
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        directory.chmod(0o700)
    except (OSError, RuntimeError):
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    # Our kernels are small: by default none would be kept.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def compile_quickly(*flags: str) -> None:
    """Leave out what takes XLA long, where programs run once or have little to do.

    It is of no use once JAX has compiled, or where the environment has `XLA_FLAGS` of its own.

    **Arguments:**

    - `flags`: more flags of XLA, which every version of JAX knows that jaxcell allows.
    """
    # XLA stops a process at a flag that it does not know.
    if jax.__version_info__ < (0, 11):
        flags += ("--xla_cpu_use_fusion_emitters=false",)
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))
