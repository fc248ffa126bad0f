"""Measure the free memory, and refuse computations that need more."""

import functools
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal


PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")
"""Folders in which Linux reports free memory (`PROC`) and limits of control groups (`GROUPS`)."""
# Limits above this mean no limit: control groups of version 1 then have a number near 2^63.
_NO_LIMIT = 2**60
LIBRARIES = 200_000_000
"""Assumed minimum number of bytes that Python, JAX and other loaded libraries use."""
NEGLIGIBLE = 20_000_000
"""Requests of at most this number of bytes are accepted without measuring the free memory."""
# The addresses that a library and those before it reserve when they start, and for each processor.
# Below that a command on two processors hung or aborted.
_ADDRESSES = {
    "NumPy": (120_000_000, 40_000_000),
    "xarray": (550_000_000, 40_000_000),
    "JAX": (1_700_000_000, 100_000_000),
}
LIMIT = "JAXCELL_MEMORY"
"""Environment variable with the memory limit of a process, such as `8G`."""


def free() -> int | None:
    """Measure the bytes that this process may still use; return `None` if they are unknown.

    The result is the smallest of four numbers: the available memory of the machine, and the memory
    that is left under each of three limits. The limits are those of control groups (containers and
    batch jobs), of the address space (`ulimit -v`), and of `JAXCELL_MEMORY`.
    """
    known = [count for count, _ in _limits_left()]
    return max(0, min(known)) if known else None


def shortage(available: int) -> str:
    """Describe the `available` bytes and, if there is one, the limit that determines them."""
    left, limit = min(_limits_left(), default=(0, ""))
    # The free memory may have changed a little since it was measured.
    if not limit or left > available + NEGLIGIBLE:
        return f"{gigabytes(available)} are free"
    return f"{gigabytes(available)} are free: {limit}" if left > 0 else limit


def check(needed: float | int, doing: str, instead: str | Callable[[int], str]) -> None:
    """Raise `MemoryError` before a computation that needs more memory than is free.

    Small requests are never refused. If the free memory is unknown, no request is refused.

    **Arguments:**

    - `needed`: estimated bytes.
    - `doing`: the name of the computation, with which the error begins.
    - `instead`: advice to use less memory, or a function of the free bytes that returns the advice.
    """
    if needed <= NEGLIGIBLE:
        return
    available = free()
    if available is not None and needed > available:
        instead = instead if isinstance(instead, str) else instead(available)
        raise MemoryError(
            f"{doing} needs about {gigabytes(needed)} of memory, and {shortage(available)}; "
            f"{instead}"
        )


def check_addresses(library: Literal["NumPy", "xarray", "JAX"]) -> None:
    """Raise `MemoryError` if `ulimit -v` leaves too few addresses for a library.

    XLA and OpenBLAS hang or abort if they cannot start their threads, so this check comes before
    the first import.
    """
    base, thread = _ADDRESSES[library]
    needed = base + thread * (os.cpu_count() or 1)
    for left, limit in _addresses():
        if left < needed:
            raise MemoryError(
                f"{library} reserves about {gigabytes(needed)} of addresses, and "
                f"{gigabytes(max(left, 0))} are left: {limit}"
            )


def gigabytes(count: float | int) -> str:
    """Format a number of bytes in GB, or in MB if there are few."""
    if count < 1e8:
        return f"{count / 1e6:.0f} MB"
    return f"{count / 1e9:.1f} GB" if count < 1e11 else f"{count / 1e9:,.0f} GB"


def read_size(text: str, name: str) -> int:
    """Convert a size such as `8G` or `2.5 GB`, the value of the option `name`, to bytes."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)B?\s*", text, re.IGNORECASE)
    count = int(float(match[1]) * 1000 ** " KMGT".index(match[2].upper() or " ")) if match else 0
    if not count:
        raise ValueError(f"{name}: expected a size such as 8G or 500M, got {text!r}")
    return count


def _limits_left() -> list[tuple[int, str]]:
    """Return the bytes that are left under each limit, with a description of the limit."""
    return [*_machine(), *_control_groups(), *_addresses(), *_user_limit()]


def _user_limit() -> Iterator[tuple[int, str]]:
    """Yield the bytes left under `JAXCELL_MEMORY`, assuming that `LIBRARIES` or more are in use."""
    if text := os.environ.get(LIMIT):
        pages = [int(line.split()[1]) for line in _lines(PROC / "self" / "statm")]
        taken = sum(pages) * os.sysconf("SC_PAGE_SIZE") if pages else 0
        taken = max(taken, LIBRARIES)
        libraries = f"of which Python and its libraries take {gigabytes(taken)}"
        left = read_size(text, LIMIT) - taken
        yield left, f"--memory or {LIMIT} allows {text.strip()}, {libraries}"


def _machine() -> Iterator[tuple[int, str]]:
    for line in _lines(PROC / "meminfo"):
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) * 1024, ""
            return
    try:
        yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), ""
    except (ValueError, OSError, AttributeError):
        return


def _control_groups() -> Iterator[tuple[int, str]]:
    """Yield the bytes left in each control group of this process, and in its parent groups."""
    for folder, most, used, cache in _limits(PROC, GROUPS):
        stat = _lines(folder / "memory.stat")
        # The system can free cached pages of files.
        spare = [int(line.split()[1]) for line in stat if line.startswith(cache + " ")]
        yield (
            most - (_number(folder / used) or 0) + sum(spare),
            f"the control group of this container or batch job allows {gigabytes(most)}",
        )


# Cached, because reading the folders takes longer than mapping the cells of a small map.
@functools.cache
def _limits(proc: Path, groups: Path) -> list[tuple[Path, int, str, str]]:
    """List the control groups that limit memory.

    Each entry contains the folder of a group, its limit in bytes, the name of the file with the
    number of used bytes, and the name of the field with the number of cached bytes.
    """
    groups_with_limit = []
    for line in _lines(proc / "self" / "cgroup"):
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root, limit, used, cache = groups, "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            root, cache = groups / "memory", "total_inactive_file"
            limit, used = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        # Inside a container the root folder is the control group of the container.
        here = root / path.strip("/")
        for folder in {root, *(one for one in (here, *here.parents) if root in one.parents)}:
            most = _number(folder / limit)
            if most is not None and most <= _NO_LIMIT:
                groups_with_limit.append((folder, most, used, cache))
    return groups_with_limit


def _addresses() -> Iterator[tuple[int, str]]:
    if sys.platform != "linux":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        for line in _lines(PROC / "self" / "statm"):
            left = limit - int(line.split()[0]) * resource.getpagesize()
            yield left, f"ulimit -v allows {gigabytes(limit)} of addresses"


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except (OSError, ValueError):
        return []


def _number(path: Path) -> int | None:
    text = "".join(_lines(path)).strip()
    return int(text) if text.isdigit() else None
