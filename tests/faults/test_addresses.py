"""Commands under a limit on addresses, which depends on the libraries: only in `make faults`."""

import os
import shlex
import subprocess
import sys

import pytest

from jaxcell import bundled


COMMANDS = {
    "localize": ["localize", str(bundled("maps/lab_a.json")), "--bounce", "45"],
    "maps": ["maps"],
    "sweep": ["sweep", str(bundled("sweeps/lab_groups.toml"))],
}


@pytest.mark.skipif("JAXCELL_FAULTS" not in os.environ, reason="slow, and differs by machine")
@pytest.mark.skipif(sys.platform != "linux", reason="addresses are limited on Linux")
@pytest.mark.parametrize("limit", [180, 300, 600, 1000])
@pytest.mark.parametrize("name", COMMANDS)
def test_no_limit_of_addresses_hangs_or_has_a_traceback(limit, name, tmp_path):
    command = [sys.executable, "-m", "jaxcell", *COMMANDS[name]]
    script = f"ulimit -v {limit * 1000}; exec {shlex.join(command)}"
    # OpenBLAS, which looks for memory forever, is ended only by SIGKILL.
    ended = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, timeout=300, cwd=tmp_path
    )
    assert ended.returncode in (0, 2)
    if ended.returncode == 2:
        said = [line for line in ended.stderr.splitlines() if not line.startswith("reading")]
        assert len(said) == 1
        assert said[0].startswith(f"jaxcell {name}: ")
        assert "memory" in said[0] or "addresses" in said[0]
