import json
import math

import pytest

from jaxcell.robot.run_log import RunLog, read_log


def test_a_log_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "run.jsonl"
    with RunLog(path, {}) as log:
        for observation in (0, 1, 1):
            log.event("observation", observation=observation)
        log.event("end", result="localized")
    whole = path.read_bytes()
    for length in range(whole.index(b"\n") + 1, len(whole)):
        path.write_bytes(whole[:length])
        run = read_log(path)
        assert run.observations == "011"[: whole[:length].count(b"\n") - 1]
        assert run.whole == (whole[length - 1 : length] == b"\n")


def test_a_log_whose_end_is_not_written_is_closed(tmp_path):
    def fail(name, fields):
        raise OSError("no space left")

    def run(log):
        with log:
            log.on_event = fail
            raise RuntimeError("the line is lost")

    log = RunLog(tmp_path / "run.jsonl", {})
    with pytest.raises(OSError, match="no space left"):
        run(log)
    with pytest.raises(ValueError, match="closed file"):
        log.event("note")


def test_a_header_that_is_not_json_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        RunLog(tmp_path / "run.jsonl", {"cell_m": math.nan})
    assert not list(tmp_path.iterdir())


def test_an_error_ends_a_log_with_its_reason(tmp_path):
    def run() -> None:
        with RunLog(tmp_path / "run.jsonl", {}) as log:
            log.event("observation", observation=1)
            raise RuntimeError("the line is lost")

    with pytest.raises(RuntimeError):
        run()
    assert read_log(tmp_path / "run.jsonl").events[-1]["reason"] == "RuntimeError: the line is lost"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: expected the log of a robot"),
        ("{}\n", "line 1: expected the log of a robot"),
        ("[]\n", "line 1: expected a JSON object"),
        ("{HEADER}\n{\n", "line 2: "),
        ('{HEADER}\n{"event": 3}\n', "line 2: event: expected a name, got 3"),
        ('{HEADER}\n{"event": "observation", "observation": 2}\n', "line 2: observation: expected"),
    ],
)
def test_a_file_that_is_not_a_log_is_refused(tmp_path, text, message):
    header = json.dumps({"format": "jaxcell-robot-log", "version": 1})
    path = tmp_path / "run.jsonl"
    path.write_text(text.replace("{HEADER}", header))
    with pytest.raises(ValueError, match=message):
        read_log(path)
