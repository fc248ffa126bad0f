import subprocess
import sys

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


def test_a_browser_is_served_from_this_machine_only(results, calls):
    assert main(["view", "--web", str(results / "b.rrd")]) == 0
    [command] = calls
    assert command[-4:] == ["--bind", "127.0.0.1", "--serve-web", str(results / "b.rrd")]


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
