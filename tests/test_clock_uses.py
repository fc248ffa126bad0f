"""Tests wait for events and not for seconds; the lines that read a clock are counted here.

A test that needs to wait uses `wait_until` of `tests/waiting.py`, whose limit is generous; rates
are computed with a clock that the test passes; ports are those that the system gives for 0.
"""

import re
from collections import Counter
from pathlib import Path


TESTS = Path(__file__).parent
CLOCK = re.compile(
    r"\b(time\.)?(sleep|monotonic|monotonic_ns|perf_counter)\("
    r"|\btime\.time\(|\btimeout=|\.wait\(\w|\bTimer\(|\bsetitimer\("
)

# By file: the number of lines, and the reason why they cannot decide how a test ends.
USES = {
    "base/test_process.py": (6, "Processes that wait to be ended, or clean up long enough."),
    "base/test_results.py": (2, "Programs that wait for a signal, however late it comes."),
    "cli/robot/test_robot_alone.py": (1, "A process that hangs is ended after minutes."),
    "cli/test_view.py": (1, "A process that waits to be ended ends by itself if the test fails."),
    "faults/test_addresses.py": (1, "A command that hangs is ended after minutes."),
    "faults/test_faults.py": (4, "Moments to interrupt at are random; a limit of minutes."),
    "mutations.py": (2, "Seconds of the processor: a reader takes a hundredth of them."),
    "record/test_robot.py": (1, "A process that waits to be killed, however long that takes."),
    "robot/create/test_create.py": (
        4,
        "Pauses between exchanges or commands; a process that is ended.",
    ),
    "robot/emulation/test_emulator.py": (
        1,
        "A moment in which nothing may happen, and a slow machine only makes that easier.",
    ),
    "robot/ros/test_ros.py": (
        1,
        "A process that waits to be killed ends by itself if the test fails.",
    ),
    "robot/emulation/test_simulated.py": (4, "Seconds of the simulated robot."),
    "ros_stub.py": (1, "The pause of the stub between two turns."),
    "sweep/test_engines.py": (
        3,
        "A chunk that hangs for minutes is late after any time; others take milliseconds of 2 s. "
        "Two lines are refused values.",
    ),
    "sweep_kills.py": (5, "Moments to kill at are random; any is right. A limit of minutes."),
    "sweep_stub.py": (4, "Chunks that take some time or hang; names of files."),
    "waiting.py": (3, "The function that waits, with its limit."),
}


def test_clocks_are_read_where_the_list_says():
    found = Counter(
        str(path.relative_to(TESTS))
        for path in TESTS.rglob("*.py")
        if path != Path(__file__)
        for line in path.read_text(encoding="utf-8").splitlines()
        if CLOCK.search(line)
    )
    assert found == {name: lines for name, (lines, _) in USES.items()}


def test_ports_are_chosen_by_the_system():
    number = re.compile(r"create_server\(\(\"[\d.]*\", [1-9]|\.bind\(\(\"[\d.]*\", [1-9]")
    for path in TESTS.rglob("*.py"):
        assert not number.search(path.read_text(encoding="utf-8")), path
