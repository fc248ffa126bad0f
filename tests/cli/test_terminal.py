import contextlib
import re
import time

import pytest

from jaxcell.cli import terminal


@pytest.fixture
def quick(monkeypatch):
    """A line after 0.1 s, and then one every 0.2 s."""
    monkeypatch.setattr(terminal, "_FIRST_LINE", 0.1)
    monkeypatch.setattr(terminal, "_LINES", 0.2)


def test_work_that_lasts_is_told_in_lines(quick, capsys):
    with terminal.status("thinking") as show:
        time.sleep(0.2)
        show("thinking hard")
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "thinking ... (0:00:00)"
    assert lines[1] == "thinking hard ... (0:00:00)"


def test_nothing_is_said_of_work_that_does_not_last(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "_FIRST_LINE", 2.0)
    with contextlib.suppress(ValueError), terminal.status("thinking"):
        raise ValueError
    assert capsys.readouterr() == ("", "")


def test_progress_says_how_long_the_rest_takes(quick, capsys, monkeypatch):
    with terminal.progress("counting") as say:
        say("counting", 10, 1000)
        time.sleep(0.15)
        say("counting", 11, 1000, "1 sheep")
        time.sleep(0.2)
    first, second, *_ = capsys.readouterr().err.splitlines()
    assert first == "counting: 10 of 1,000 ... (0:00:00)"
    found = re.fullmatch(
        r"counting: 11 of 1,000, 1 sheep, (\d):(\d\d):(\d\d) left \.\.\. \(0:00:0\d\)", second
    )
    hours, minutes, seconds = map(int, found.groups())
    # One took 0.15 s at least, and 989 are left; whole seconds are shown.
    assert 3600 * hours + 60 * minutes + seconds >= int(0.15 * 989)
