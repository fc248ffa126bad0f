import contextlib
import importlib
import signal
import subprocess
import sys

import pytest
from waiting import is_running, wait_until

from jaxcell.base import process
from jaxcell.base.paths import replacing
from jaxcell.base.process import guarded


_STARTS = """
import subprocess, sys, time
from jaxcell.base.paths import replacing
from jaxcell.base.process import guarded
child = "import os, time; print(os.getpid(), flush=True); time.sleep(300)"
command = guarded([sys.executable, "-c", child])
server = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
print(server.pid, flush=True)
server.wait()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_guarded_command_ends_with_the_process_that_started_it(number):
    command = [sys.executable, "-c", _STARTS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        pids = [int(process.stdout.readline()) for _ in range(2)]
        process.send_signal(number)
    wait_until(lambda: not any(map(is_running, pids)))


def test_a_guarded_command_ends_with_its_own_status():
    command = guarded([sys.executable, "-c", "raise SystemExit(7)"])
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        assert process.wait() == 7


_DISCARDS = """
import signal, sys, time
from jaxcell import cli
from jaxcell.cli import app
class Slow:
    def __del__(self):
        print("ready", flush=True)
        time.sleep(300)
def run(_):
    Slow()
    print("deaf", flush=True)
    time.sleep(300)
app.run = run
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(cli.main([]))
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_whose_exception_is_discarded_comes_again(number, status):
    command = [sys.executable, "-c", _DISCARDS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        process.stdout.read()
    assert process.returncode == status


_LOSES = """
import signal, sys, time
from jaxcell import cli
from jaxcell.base.process import keep_running
from jaxcell.cli import app
class Slow:
    def __enter__(self):
        return self
    def __exit__(self, *_):
        time.sleep(2)
        print("cleaned up", flush=True)
def run(_):
    try:
        with Slow():
            print("ready", flush=True)
            time.sleep(300)
    except:
        {caught}
    time.sleep({seconds})
    return 3
app.run = run
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(cli.main([]))
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.parametrize(("caught", "seconds"), [("pass", 300), ("pass", 0), ("keep_running()", 3)])
def test_a_signal_that_is_lost_comes_again_but_not_while_it_is_handled(
    number, status, caught, seconds
):
    command = [sys.executable, "-c", _LOSES.format(caught=caught, seconds=seconds)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.stdout.read() == "cleaned up\n"
    assert process.returncode == (status if caught == "pass" else 3)


@pytest.mark.parametrize(
    ("number", "error"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_a_signal_waits_until_a_module_is_imported(number, error, tmp_path, monkeypatch):
    """Compiled modules may abort the process if an import in them is interrupted."""
    name = f"interrupted_{number}"
    text = f"import signal\nsignal.raise_signal({int(number)})\nwhole = True\n"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(process, "_received", [])
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    handled = process.end_by_signals()
    try:
        assert importlib.import_module(name).whole
        with pytest.raises(error):
            wait_until(lambda: False)
    finally:
        process.leave_signals(handled)
        signal.signal(signal.SIGINT, before)


def write_and_lose_a_signal(path):
    with process.signals_sent_again(), replacing(path) as name:
        name.write_text("after")
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_no_file_is_replaced_after_a_signal_was_lost(tmp_path):
    (tmp_path / "a").write_text("before")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    handled = process.end_by_signals()
    try:
        with pytest.raises(KeyboardInterrupt):
            write_and_lose_a_signal(tmp_path / "a")
    finally:
        process.leave_signals(handled)
        signal.signal(signal.SIGINT, before)
    assert (tmp_path / "a").read_text() == "before"
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


def test_a_program_that_caught_the_exception_of_a_signal_is_not_ending():
    handled = process.end_by_signals()
    try:
        with pytest.raises(SystemExit):
            signal.raise_signal(signal.SIGTERM)
        assert process.is_ending()
    finally:
        process.leave_signals(handled)
    assert not process.is_ending()


class Interrupted:
    """A key of a hash table during whose hash or comparison SIGTERM comes."""

    def __hash__(self):
        signal.raise_signal(signal.SIGTERM)
        return 0

    def __eq__(self, other):
        signal.raise_signal(signal.SIGTERM)
        return self is other


@pytest.mark.parametrize("use", [hash, lambda key: key == 0])
def test_a_signal_waits_for_methods_that_compiled_code_calls(use, monkeypatch):
    monkeypatch.setattr(process, "_received", [])
    handled = process.end_by_signals()
    try:
        assert use(Interrupted()) == 0
        with pytest.raises(SystemExit):
            wait_until(lambda: False)
    finally:
        process.leave_signals(handled)
