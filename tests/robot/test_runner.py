import functools
import json
import math

import pytest
from wheels import bounce_filter, bounce_tables, map_cells, walker_in as walker_with

from jaxcell import examples
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.followers import FilterFollower, replay_follower, run_follower
from jaxcell.robot.plan import plan_outcome, run_plan
from jaxcell.robot.run_log import RunLog, read_log


LAB_A, LAB_B = map_cells("lab_a.json"), map_cells("lab_b.json")
# These tests do not depend on the driver.
walker_in = functools.partial(walker_with, robot=DirectBody)


def logged_run(path, cell, degrees, until="known"):
    """Run a filter of Lab A with a log."""
    follower = FilterFollower(bounce_filter(LAB_A, degrees), until)
    walker, _ = walker_in(LAB_A, cell)
    with RunLog(path, {"kind": "filter"}) as log:
        return run_follower(walker, follower, [math.radians(degrees)], log=log)


@pytest.mark.parametrize("open_world", [False, True])
def test_a_filter_of_another_map_is_refuted_with_its_observations(open_world):
    """From some cells of Lab A, a robot has observations that are impossible in Lab B."""
    filter = bounce_filter(LAB_B, 45, open_world=open_world)
    image, bumped = bounce_tables(LAB_A, 45)
    refuted = 0
    for cell in range(0, LAB_A.size, 19):
        walker, _ = walker_in(LAB_A, cell)
        outcome = run_follower(walker, FilterFollower(filter, "cycle"), [math.radians(45)])
        observed = ""
        for _ in outcome.observations:
            observed += str(int(bumped[cell]))
            cell = int(image[cell])
        assert outcome.observations == observed
        if outcome.result == "refuted":
            refuted += 1
            with pytest.raises(ValueError, match=f"observation {len(observed) - 1} is"):
                bounce_filter(LAB_B, 45).run(observed)
            bounce_filter(LAB_B, 45).run(observed[:-1])
            assert outcome.cells == ()
            assert outcome.reason.endswith(f"the robot observed {observed}")
            assert outcome.colors[-1] == (filter.color[-1] if open_world else 0)
    assert refuted >= 2


def test_a_run_ends_where_one_configuration_is_left_or_in_the_cycle(tmp_path):
    filter, (image, bumped) = bounce_filter(LAB_A, 135), bounce_tables(LAB_A, 135)
    # From this cell, one configuration is left long before the knowledge cycle.
    start = cell = 148
    state, word, known, ends = filter.start(), "", 0, []
    while not state.localized:
        word += str(int(bumped[cell]))
        cell = int(image[cell])
        ends.append(cell)
        state = state.observe(int(word[-1]))
        known = known or (len(word) if state.uncertainty == 1 else 0)
    assert known < len(word) - 5
    outcomes = {}
    for until in ("known", "cycle"):
        path = tmp_path / f"{until}.jsonl"
        outcomes[until] = logged_run(path, start, 135, until)
        run = read_log(path)
        # A replay does not need to know the end of the run, which old logs do not contain.
        for follower in (FilterFollower(filter), FilterFollower(filter, until)):
            assert replay_follower(run, follower) == outcomes[until]
    assert outcomes["known"].observations == word[:known]
    assert outcomes["known"].cells == (ends[known - 1],)
    assert outcomes["cycle"].observations == word
    assert {outcome.result for outcome in outcomes.values()} == {"localized"}


def test_the_limit_ends_a_run():
    walker, _ = walker_in(LAB_A, 70)
    outcome = run_follower(
        walker, FilterFollower(bounce_filter(LAB_A, 45)), [math.radians(45)], limit=3
    )
    assert outcome.result == "unfinished"
    assert len(outcome.observations) == len(outcome.colors) == 3
    assert outcome.reason.startswith("not localized after 3 observations; ")


def test_a_log_is_written_as_it_goes_and_replays_to_the_same_colours(tmp_path):
    path = tmp_path / "run.jsonl"
    filter = bounce_filter(LAB_A, 45)
    walker, _ = walker_in(LAB_A, 70)
    heard = []
    with RunLog(path, {"kind": "filter", "bounce_deg": 45}) as log:
        log.on_event = lambda name, fields: heard.append(
            ({"event": name, **fields}, json.loads(path.read_text().splitlines()[-1]))
        )
        outcome = run_follower(walker, FilterFollower(filter), [math.radians(45)], log=log)
    # Each event is in the file before the robot continues.
    assert all(event == written for event, written in heard)
    run = read_log(path)
    assert run.whole
    assert [event for event, _ in heard] == list(run.events)
    assert run.header["bounce_deg"] == 45
    assert run.observations == outcome.observations
    assert run.colors == list(outcome.colors) == filter.run(run.observations).colors[1:].tolist()
    assert run.events[-1] == {
        "event": "end",
        "seconds": run.events[-1]["seconds"],
        "result": "localized",
        "reason": outcome.reason,
    }
    assert replay_follower(run, FilterFollower(filter)) == outcome
    with pytest.raises(ValueError, match=r"observation \d+: the log has colour"):
        replay_follower(run, FilterFollower(bounce_filter(LAB_A, 135)))
    with pytest.raises(FileExistsError):
        RunLog(path, {})


def test_a_log_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "run.jsonl"
    outcome = logged_run(path, 70, 45)
    whole = path.read_bytes()
    lines = whole.count(b"\n")
    for length in range(whole.index(b"\n") + 1, len(whole)):
        path.write_bytes(whole[:length])
        run = read_log(path)
        events = whole[:length].count(b"\n") - 1
        assert run.observations == outcome.observations[: min(events, lines - 2)]
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


def test_a_plan_that_meets_another_map_is_refuted():
    """In a corridor of three cells, the third step bumps."""
    for actions, observations, text in [
        ([0.0, 0.0, 0.0], "001", "action 2 of 3: the robot bumped where the plan has free space"),
        ([1.0, 0.0, 0.0], "0", "action 0 of 3: the robot met no wall where the plan has one"),
    ]:
        outcome = run_plan(examples.walker(), actions)
        assert outcome.result == "refuted"
        assert outcome.reason == f"{text}; the robot observed {observations}"
        assert plan_outcome(actions, "").result == "unfinished"
