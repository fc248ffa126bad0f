import contextlib

import pytest
from waiting import wait_until

from jaxcell.cli import terminal


@pytest.fixture
def heard(monkeypatch, capsys):
    """A function that waits for a line on standard error; lines come as fast as they can."""
    monkeypatch.setattr(terminal, "FIRST_LINE", 0.0)
    monkeypatch.setattr(terminal, "LINES", 0.01)
    text = ""

    def said(line):
        nonlocal text
        text += capsys.readouterr().err
        return line in text.splitlines()

    return lambda line: wait_until(lambda: said(line))


def test_long_work_prints_a_line_every_minute(heard):
    now = 0.0
    with terminal.status("thinking", clock=lambda: now) as show:
        heard("thinking ... (0:00:00)")
        show("thinking hard")
        now = 61.0
        heard("thinking hard ... (0:01:01)")


def test_short_work_prints_nothing(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "FIRST_LINE", 3600.0)
    with contextlib.suppress(ValueError), terminal.status("thinking"):
        raise ValueError
    assert capsys.readouterr() == ("", "")


def test_progress_says_how_long_the_rest_takes(heard):
    now = 0.0
    with terminal.progress("counting", clock=lambda: now) as say:
        say("counting", 10, 1000)
        heard("counting: 10 of 1,000 ... (0:00:00)")
        now = 2.0
        say("counting", 11, 1000, "1 sheep")
        # One took two seconds, and 989 are left.
        heard("counting: 11 of 1,000, 1 sheep, 0:32:58 left ... (0:00:02)")
