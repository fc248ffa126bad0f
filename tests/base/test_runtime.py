import os
import subprocess
import sys


PROGRAM = """
from jaxcell.base.runtime import configure_jax
configure_jax()
import jax, jax.numpy as jnp
print(jax.jit(lambda x: x + 1)(jnp.zeros(3)).tolist())
"""


def test_a_cached_program_that_a_kill_left_empty_is_compiled_again(tmp_path):
    """JAX would print an error at every start, and keep the empty file."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True
        )
        assert (done.stdout, done.stderr, done.returncode) == ("[1.0, 1.0, 1.0]\n", "", 0)
        entries = list((tmp_path / "jaxcell" / "xla").iterdir())
        assert entries
        for entry in entries:
            assert entry.stat().st_size
            entry.write_bytes(b"")
