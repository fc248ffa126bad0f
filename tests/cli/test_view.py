import shlex
import socket
import subprocess
import sys
import urllib.parse
import webbrowser

import pytest
from waiting import is_running, wait_until

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


def test_all_recordings_of_a_folder_are_opened(results, calls, monkeypatch):
    monkeypatch.setattr(view, "has_display", lambda: True)
    assert main(["view", str(results)]) == 0
    [command] = calls
    assert command[:3] == [sys.executable, "-m", "rerun"]
    assert command[-2:] == [str(results / "b.rrd"), str(results / "one" / "a.rrd")]


SERVER = """
import socket, sys
place = (sys.argv[sys.argv.index(one) + 1] for one in ("--bind", "--web-viewer-port"))
with socket.create_server((next(place), int(next(place)))) as server:
    server.accept()
# It goes on until its address is printed.
sys.stdin.read()
"""


@pytest.mark.parametrize("display", [True, False])
@pytest.mark.parametrize("taken", [True, False])
def test_a_browser_is_opened_at_the_one_address_that_is_printed(
    results, monkeypatch, capsys, display, taken
):
    opened, started, servers = [], [], []
    popen, note = subprocess.Popen, view.note

    def start(command, **options):
        started.append(command)
        script = [sys.executable, "-c", SERVER, *command]
        servers.append(popen(script, **options))
        return servers[-1]

    def noted(text):
        note(text)
        servers[-1].stdin.close()

    monkeypatch.setattr(view, "note", noted)
    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(view, "has_display", lambda: display)
    with socket.create_server(("127.0.0.1", 0)) as other:
        if taken:
            monkeypatch.setattr(view, "PAGE_PORT", other.getsockname()[1])
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
import subprocess, sys
waiting = "import os, time; print(os.getpid(), flush=True); time.sleep(600)"
subprocess.call([sys.executable, "-c", waiting])
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
        # That of the server, and that of the process in which it runs.
        pids = [int(command.stdout.readline()) for _ in range(2)]
        command.terminate()
    wait_until(lambda: not any(map(is_running, pids)))


@pytest.mark.parametrize("display", [True, False])
def test_a_live_run_is_shown_in_a_window_or_on_a_page(monkeypatch, capsys, display):
    popen, note, servers = subprocess.Popen, view.note, []

    def start(command, **options):
        servers.append(popen([sys.executable, "-c", SERVER, *command], **options))
        return servers[-1]

    def noted(text):
        note(text)
        servers[-1].stdin.close()

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(view, "note", noted)
    monkeypatch.setattr(view, "has_display", lambda: display)
    # The usual ports may be taken by a page of another test at this moment.
    monkeypatch.setattr(view, "PAGE_PORT", 0)
    monkeypatch.setattr(view, "DATA_PORT", 0)
    with view.shown_live("here") as viewer:
        said = capsys.readouterr().err
    if display:
        assert (viewer, said) == ("here", "")
    else:
        assert viewer.startswith("rerun+http://127.0.0.1:")
        assert urllib.parse.quote(viewer, safe="") in said
    with view.shown_live("rerun+http://laptop:9876/proxy") as viewer:
        assert viewer == "rerun+http://laptop:9876/proxy"


def test_without_a_display_other_commands_are_recommended(results, calls, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(results)]) == 1
    assert calls == []
    printed = capsys.readouterr().err
    assert "view --web" in printed
    assert f"rerun {shlex.quote(str(results / 'b.rrd'))}" in printed


@pytest.mark.parametrize("name", ["nothing", "empty", "text.rrd"])
def test_other_files_than_recordings_are_refused(name, tmp_path, calls, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.rrd").write_text("text")
    assert main(["view", str(tmp_path / name)]) == 2
    assert calls == []
    assert capsys.readouterr().err.count("\n") == 1
