import subprocess
import sys
from pathlib import Path

import pytest

from jaxcell.cli import main


MAPS = Path(__file__).parents[2] / "data" / "maps"


def test_unknown_options_end_with_status_2(capsys):
    for args in (["localize"], ["nothing"], ["groups", "map.json", "--bounce", "many"]):
        with pytest.raises(SystemExit) as ended:
            main(args)
        assert ended.value.code == 2
    capsys.readouterr()


def test_localize_compiles_nothing_and_imports_little():
    code = (
        "import jax, sys\n"
        "from jaxcell.cli import main\n"
        "compiled = []\n"
        "jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__:"
        " compiled.append(name) if 'backend_compile' in name else None)\n"
        "jax.jit(lambda x: x + 1)(2.5)\n"
        "assert compiled and not compiled.clear()\n"
        "for cell in ('1', '0.93'):\n"
        "    assert main(['localize', '@lab_a', '--cell', cell, '--bounce', '45']) == 0\n"
        "assert not compiled, compiled\n"
        "assert not {'scipy', 'xarray', 'pandas'} & sys.modules.keys()\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_help_imports_neither_numpy_nor_jax():
    code = (
        "import sys, jaxcell, jaxcell.cli\n"
        "try: jaxcell.cli.main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "slow = {'jax', 'numpy', 'xarray', 'rerun', 'shapely'}\n"
        "assert not slow & sys.modules.keys(), slow & sys.modules.keys()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    for command in ("localize", "groups", "export", "demo"):
        assert command in result.stdout
