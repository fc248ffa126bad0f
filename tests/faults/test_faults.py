"""Results under interruption, damage and full disks; `make faults` tries more of each.

The moments, the signals and the flipped bits are random; any of them is right.
"""

import contextlib
import functools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from waiting import wait_until

from jaxcell.base.results import MANIFEST
from jaxcell.cli import main


MANY = os.environ.get("JAXCELL_FAULTS") is not None
COMMANDS = {
    "groups": ["groups", "@lab_a", "--bounce", "45", "135"],
    "localize": ["localize", "@lab_a", "--bounce", "135"],
    "navigate": ["navigate", "@lab_a", "--bounce", "90", "--start", "20", "--goal", "3"],
    "patrol": ["patrol", "graph", "@eight"],
    "drift": ["drift", "@gyres", "--depths", "0", "--time", "0"],
}
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGKILL]
# A shell lets programs in the background ignore SIGINT. Python itself, which prints a traceback, is
# not interrupted before the command begins.
START = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    "from jaxcell.cli import main; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "sys.exit(main(sys.argv[1:]))"
)
# A file that grows beyond the limit fails as on a full disk.
FULL = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))\n"
# A process that is still there after this time hangs, on any machine.
HANGS = 300.0


def start(words, out, before=""):
    command = [sys.executable, "-c", before + START, *words, "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def is_writing(process, out):
    """Return whether a command has begun to write files, or has ended."""
    with contextlib.suppress(FileNotFoundError):
        if f"process {process.pid} " in (out / ".writing" / "lock").read_text():
            return True
    return process.poll() is not None


def is_whole(out, capsys):
    capsys.readouterr()
    return main(["verify", str(out)]) == 0


@pytest.mark.parametrize("name", COMMANDS if MANY else ["localize"])
def test_an_interrupted_command_leaves_a_whole_result_or_none(name, tmp_path, capsys):
    rng, out = random.Random(name), tmp_path / "out"
    files = [MANIFEST]
    for number in range(20 if MANY else 3):
        with start(COMMANDS[name], out) as process:
            # Half of the moments are while files are written.
            if number % 2:
                wait_until(functools.partial(is_writing, process, out))
            moment = rng.uniform(0, 1 if number % 2 else 6)
            timer = threading.Timer(moment, process.send_signal, [rng.choice(SIGNALS)])
            timer.start()
            error = process.communicate(timeout=HANGS)[1]
            timer.cancel()
        assert "Traceback" not in error, error
        assert not (out / MANIFEST).exists() or is_whole(out, capsys), number
        if number % 4 == 2:
            with start(COMMANDS[name], out) as process:
                process.communicate(timeout=HANGS)
            assert process.returncode in (0, 1)
            assert is_whole(out, capsys)
            files = json.loads((out / MANIFEST).read_text())["files"]
            assert sorted(path.name for path in out.rglob("*") if path.is_file()) == sorted(
                [MANIFEST, *(Path(file).name for file in files)]
            )
            shutil.rmtree(out)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    out = tmp_path_factory.mktemp("sound") / "out"
    assert main([*COMMANDS["localize"], "--out", str(out)]) == 0
    return out


@pytest.mark.parametrize("seed", range(50))
def test_a_flipped_bit_is_found(seed, sound, capsys):
    rng = random.Random(seed)
    path = rng.choice(sorted(path for path in sound.iterdir() if path.is_file()))
    whole = path.read_bytes()
    damaged = bytearray(whole)
    damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
    path.write_bytes(damaged)
    assert not is_whole(sound, capsys)
    path.write_bytes(whole)
    assert is_whole(sound, capsys)


@pytest.mark.parametrize("name", COMMANDS if MANY else ["groups"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.97] if MANY else [0.97])
def test_a_full_disk_is_one_line_and_leaves_nothing(name, share, tmp_path):
    main([*COMMANDS[name], "--out", str(tmp_path / "free")])
    sizes = [path.stat().st_size for path in (tmp_path / "free").iterdir()]
    limit = FULL.format(max(int(share * max(sizes)), 1))
    with start(COMMANDS[name], tmp_path / "out", limit) as process:
        error = process.communicate(timeout=HANGS)[1]
    assert process.returncode == 2
    said = [line for line in error.splitlines() if line.startswith("jaxcell ")]
    assert len(said) == 1, error
    assert str(tmp_path / "out") in said[0]
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()
