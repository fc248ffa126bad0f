"""Configure JAX for the commands of jaxcell; other programs choose their own configuration."""

import contextlib
import os
from pathlib import Path
from typing import Any


def configure_jax() -> None:
    """Turn on 64-bit numbers, and a cache of compiled programs."""
    import jax

    for name, value in {"jax_enable_x64": True, **program_cache()}.items():
        jax.config.update(name, value)


def program_cache() -> dict[str, Any]:
    """Return the settings of JAX for a cache of compiled programs in a directory of the user.

    JAX runs the programs in the cache, so other users must not be able to write to it. If no such
    directory can be created, there are no settings. The names in capitals are environment variables
    for processes that import JAX later.
    """
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    directory = Path(home) / "jaxcell" / "xla"
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        directory.chmod(0o700)
    except (OSError, RuntimeError):
        return {}
    # JAX never repairs a file that a killed process left empty.
    with contextlib.suppress(OSError):
        for entry in os.scandir(directory):
            if not entry.stat().st_size:
                os.unlink(entry)
    return {
        "jax_compilation_cache_dir": str(directory),
        # By default JAX does not cache small programs, and most programs here are small.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }


def compile_quickly(*flags: str) -> None:
    """Turn off slow optimizations of XLA, for programs that run once or compute little.

    This has no effect after the first compilation, or if the environment has `XLA_FLAGS`.
    `flags` are further flags of XLA; every version of JAX that jaxcell supports must know them.
    """
    import jax

    # XLA ends the process for an unknown flag, so newer versions do not get this one.
    if jax.__version_info__ < (0, 11):
        flags += ("--xla_cpu_use_fusion_emitters=false",)
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))
