import os
import socket
import subprocess
import sys
import webbrowser

import pytest

from jaxcell import bundled
from jaxcell.cli import main, view


@pytest.fixture
def results(tmp_path):
    (tmp_path / "one").mkdir()
    for name in ("b.rrd", "one/a.rrd"):
        (tmp_path / name).write_bytes(b"RRF2 and so on")
    return tmp_path


@pytest.fixture
def calls(monkeypatch):
    calls = []
    monkeypatch.setattr(subprocess, "call", lambda command: calls.append(command) or 0)
    return calls


def test_all_recordings_of_a_directory_are_opened(results, calls, monkeypatch):
    monkeypatch.setattr(view, "has_display", lambda: True)
    assert main(["view", str(results)]) == 0
    [command] = calls
    assert command[:3] == [sys.executable, "-m", "rerun"]
    assert command[-2:] == [str(results / "b.rrd"), str(results / "one" / "a.rrd")]


SERVER = """
import socket, sys, time
place = (sys.argv[sys.argv.index(one) + 1] for one in ("--bind", "--web-viewer-port"))
with socket.create_server((next(place), int(next(place)))) as server:
    server.accept()
# Whoever connects looks whether it goes on.
time.sleep(0.3)
"""


@pytest.mark.parametrize("display", [True, False])
@pytest.mark.parametrize("taken", [True, False])
def test_a_browser_is_opened_at_the_one_address_that_is_printed(
    results, monkeypatch, capsys, display, taken
):
    opened, started = [], []
    popen = subprocess.Popen

    def start(command, **options):
        started.append(command)
        return popen([sys.executable, "-c", SERVER, *command], **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(view, "has_display", lambda: display)
    with socket.create_server(("127.0.0.1", 0)) as other:
        if taken:
            monkeypatch.setattr(view, "_PAGE_PORT", other.getsockname()[1])
        assert main(["view", "--web", str(results / "b.rrd")]) == 0
    [command] = started
    assert command[-2:] == ["--serve-web", str(results / "b.rrd")]
    page, data = (command[command.index(one) + 1] for one in ("--web-viewer-port", "--port"))
    said = capsys.readouterr().err
    assert said.split() == [
        f"http://127.0.0.1:{page}?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{data}%2Fproxy"
    ]
    assert opened == said.split() * display


WAITING = """
import sys, time
print("ready", flush=True)
time.sleep(60)
"""
VIEWING = """
import subprocess, sys
from jaxcell.cli import main, view
popen = subprocess.Popen
def start(command, **options):
    server = popen([sys.executable, "-c", sys.argv[2]], **options)
    print(server.pid, flush=True)
    return server
subprocess.Popen = start
main(["view", "--web", sys.argv[1]])
"""


def test_the_server_ends_with_the_command(results):
    viewing = [sys.executable, "-c", VIEWING, str(results / "b.rrd"), WAITING]
    with subprocess.Popen(viewing, stdout=subprocess.PIPE, text=True) as command:
        said = [command.stdout.readline().strip() for _ in range(2)]
        command.terminate()
    said.remove("ready")
    with pytest.raises(ProcessLookupError):
        os.kill(int(said[0]), 0)


def test_without_a_display_it_says_how(results, calls, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(results)]) == 1
    assert calls == []
    told = capsys.readouterr().err
    assert "view --web" in told
    assert f"rerun {results / 'b.rrd'}" in told


@pytest.mark.parametrize("name", ["nothing", "empty", "text.rrd"])
def test_what_is_no_recording_is_refused(name, tmp_path, calls, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.rrd").write_text("text")
    assert main(["view", str(tmp_path / name)]) == 2
    assert calls == []
    assert capsys.readouterr().err.count("\n") == 1


def test_bundled_data_are_found_by_name():
    assert bundled("maps/lab_a.json").is_file()
    with pytest.raises(FileNotFoundError, match="maps/lab_z"):
        bundled("maps/lab_z.json")
