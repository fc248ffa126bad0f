"""A command that Ctrl-C or SIGTERM ends gives what it has computed until then."""

import json
import os
import signal

import pytest
from helpers import run

from jaxcell import bundled, study
from jaxcell.drift import SeaDrift, released_drifters


PLACE = "--start=-117.93,33.5"

pytestmark = pytest.mark.usefixtures("few_drifters")


def _signalled(monkeypatch, owner, name, calls, number=signal.SIGINT):
    """Send a signal to this process in one of the calls of a function."""
    original, left = getattr(owner, name), [calls]

    def call(*args, **options):
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), number)
        return original(*args, **options)

    monkeypatch.setattr(owner, name, call)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_release_has_the_times_until_then(capsys, monkeypatch, tmp_path, number, status):
    _signalled(monkeypatch, released_drifters, "drifted", 20, number)
    command = "release @gyres --until 0.5 --precision 0.1", PLACE, f"--out {tmp_path / 'out'}"
    code, answer, error = run(capsys, *command)
    assert code == status
    assert answer["stopped"]
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["stopped"]
    features = json.loads((tmp_path / "out" / "release.geojson").read_text())["features"]
    # Looks are half an hour apart or less, so 20 of them are before 10 h.
    assert 0 < max(one["properties"]["hours"] for one in features) < 10
    assert "Stopped: the answer is of what was computed until then." in error


def test_a_stopped_repeated_release_has_the_releases_until_then(capsys, monkeypatch):
    _signalled(monkeypatch, released_drifters, "drifted", 60)
    period = "--on 2011-07-01T00:00/2011-07-01T12:00 --every 0.1 --until 0.2"
    code, answer, _ = run(capsys, "release @gyres --precision 0.1", PLACE, period)
    assert code == 130
    assert 0 < len(answer["starts"]) < 5
    assert answer["released"] % len(answer["starts"]) == 0


def test_a_stopped_drift_has_its_map_without_the_parts_to_come(capsys, monkeypatch):
    _signalled(monkeypatch, SeaDrift, "with_closed_sets", 1)
    code, answer, _ = run(capsys, "drift @gyres --depths 0 --method source --time 0")
    assert code == 130
    assert answer["layers"]
    assert "nearly_closed_sets" not in answer


def test_in_a_program_an_interrupt_goes_on(monkeypatch):
    _signalled(monkeypatch, released_drifters, "drifted", 20)
    with pytest.raises(KeyboardInterrupt):
        study.Release(
            file=(bundled("ocean/gyres.nc"),), start="-117.93,33.5", until=0.5, precision=0.1
        ).run()
