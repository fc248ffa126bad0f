import os
import sys
from pathlib import Path

import pytest
from helpers import python

from jaxcell.base import memory


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Writes files of a system that tells as little as is written."""
    monkeypatch.setattr(memory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "groups")
    monkeypatch.delenv(memory.LIMIT, raising=False)

    def write(name, text):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    return write


def test_the_available_memory_of_the_machine_is_free(system):
    system("proc/meminfo", "MemTotal: 8000 kB\nMemFree: 10 kB\nMemAvailable:    5000 kB\n")
    assert memory.free() == 5000 * 1024


@pytest.mark.parametrize("place", ["groups/job/step", "groups/job", "groups"])
def test_control_groups_limit_the_free_memory(system, place):
    system("proc/meminfo", "MemAvailable: 5000 kB\n")
    system("proc/self/cgroup", "0::/job/step\n")
    system("groups/job/step/memory.max", "max\n")
    system(f"{place}/memory.max", "3000000\n")
    system(f"{place}/memory.current", "1000000\n")
    system(f"{place}/memory.stat", "anon 5\ninactive_file 200000\nactive_file 7\n")
    assert memory.free() == 2_200_000


def test_control_groups_of_version_1_limit_the_free_memory(system):
    system("proc/meminfo", "MemAvailable: 5000 kB\n")
    system("proc/self/cgroup", "5:cpu:/\n4:memory:/job\n0::/\n")
    system("groups/memory/memory.limit_in_bytes", "9223372036854771712\n")
    system("groups/memory/job/memory.limit_in_bytes", "3000000\n")
    system("groups/memory/job/memory.usage_in_bytes", "1000000\n")
    assert memory.free() == 2_000_000


def test_a_full_control_group_leaves_no_memory(system):
    system("proc/self/cgroup", "0::/\n")
    system("groups/memory.max", "10")
    system("groups/memory.current", "11")
    assert memory.free() == 0


def test_the_limit_of_the_user_includes_the_memory_in_use(system, monkeypatch):
    system("proc/meminfo", "MemAvailable: 5000000 kB\n")
    monkeypatch.setenv(memory.LIMIT, "2G")
    assert memory.free() == 2_000_000_000 - memory.LIBRARIES
    pages = 1_000_000_000 // os.sysconf("SC_PAGE_SIZE")
    system("proc/self/statm", f"0 {pages} 5 1 0 7 0\n")
    assert memory.free() == 2_000_000_000 - pages * os.sysconf("SC_PAGE_SIZE")
    monkeypatch.setenv(memory.LIMIT, "100M")
    assert memory.free() == 0


@pytest.mark.parametrize(
    ("text", "size"), [("8G", 8e9), ("500m", 5e8), ("2.5 GB", 2.5e9), ("1T", 1e12), ("70000", 7e4)]
)
def test_sizes_are_read(text, size):
    assert memory.read_size(text, "memory") == size


@pytest.mark.parametrize("text", ["", "much", "8X", "-1G", "0", "1e3", "inf", "8 G B"])
def test_other_texts_are_refused_as_sizes(text):
    with pytest.raises(ValueError, match=r"^memory: expected a size such as 8G or 500M, got "):
        memory.read_size(text, "memory")


def test_nothing_is_refused_if_the_free_memory_is_unknown(system, monkeypatch):
    system("proc/meminfo", "MemTotal: none of our business\n")
    monkeypatch.setattr(os, "sysconf", lambda name: -1 if name == "SC_PAGE_SIZE" else 1)
    monkeypatch.delattr(os, "sysconf")
    assert memory.free() is None
    memory.check(1e30, "this", "that")


def test_a_refusal_is_one_line_with_both_numbers(system, monkeypatch):
    monkeypatch.setattr(memory, "free", lambda: 2 * 10**9)
    memory.check(2e9, "this", "that")
    with pytest.raises(MemoryError) as refused:
        memory.check(3.21e9, "this", "that would fit")
    expected = "this needs about 3.2 GB of memory, and 2.0 GB are free; that would fit"
    assert str(refused.value) == expected


@pytest.mark.parametrize(
    ("wished", "job", "said"),
    [
        ("", "max", "5.1 GB are free"),
        (
            "",
            "3000000000",
            "2.0 GB are free: the control group of this container or batch job allows 3.0 GB",
        ),
        (
            "100M",
            "3000000000",
            "--memory or JAXCELL_MEMORY allows 100M, of which Python and its libraries take 0.2 GB",
        ),
    ],
)
def test_a_refusal_names_the_limit(system, monkeypatch, wished, job, said):
    system("proc/meminfo", "MemAvailable: 5000000 kB\n")
    system("proc/self/cgroup", "0::/\n")
    system("groups/memory.max", f"{job}\n")
    system("groups/memory.current", "1000000000\n")
    monkeypatch.setenv(memory.LIMIT, wished)
    with pytest.raises(MemoryError) as refused:
        memory.check(1e11, "this", "that would fit")
    expected = f"this needs about 100 GB of memory, and {said}; that would fit"
    assert str(refused.value) == expected


@pytest.mark.skipif(sys.platform != "linux", reason="limits of addresses are known on Linux")
def test_the_limit_of_addresses_limits_the_free_memory():
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (10**9, 10**9));"
        "from jaxcell.base.memory import free, shortage; print(free(), shortage(free()))"
    )
    root = Path(memory.__file__).parents[1]
    left, _, said = python("-c", code, cwd=root)[0].partition(" ")
    assert 10**8 < int(left) < 10**9
    assert said.endswith(" GB are free: ulimit -v allows 1.0 GB of addresses\n")
