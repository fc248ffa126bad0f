"""How much memory is free, and what is refused because it takes more."""

import functools
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path


_PROC = Path("/proc")
_GROUPS = Path("/sys/fs/cgroup")
# Of a control group without a limit, version 1 says a number next to 2^63.
_NO_LIMIT = 2**60
LIBRARIES = 200_000_000
"""The bytes that Python, JAX and other libraries take themselves, once they are loaded."""
NEGLIGIBLE = 20_000_000
"""The bytes that are never refused: to ask what is free takes longer than to fill them."""
LIMIT = "JAXCELL_MEMORY"
"""The environment variable that says how much a process may take, such as `8G`."""


def free() -> int | None:
    """How many bytes this process may still take, `None` where the system does not say.

    That is the least of what the machine has available, what the control groups of this process
    leave (containers and batch systems set them), its own limit of addresses (`ulimit -v`), and
    what `JAXCELL_MEMORY` leaves.

    **Raises:** `ValueError` if that is no size.
    """
    known = [count for count, _ in _known()]
    return max(0, min(known)) if known else None


def shortage(available: int) -> str:
    """Say how much memory is free, and which limit leaves so little, if it is not the machine's.

    **Arguments:**

    - `available`: what `free` says.
    """
    left, limit = min(_known(), default=(0, ""))
    # What is left may have changed a little since.
    named = f": {limit}" if limit and left <= available + NEGLIGIBLE else ""
    return f"{gigabytes(available)} are free{named}"


def check(needed: float | int, doing: str, instead: str | Callable[[int], str]) -> None:
    """Refuse what takes more memory than is free, before it begins.

    What is negligible is not, and nothing is where it is not known what is free.

    **Arguments:**

    - `needed`: bytes, estimated.
    - `doing`: what takes them.
    - `instead`: what would take fewer, or a function that says so of the bytes that are free.

    **Raises:** `MemoryError` with both numbers, in one line.
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


def gigabytes(count: float | int) -> str:
    """Bytes as people read them."""
    return f"{count / 1e9:.1f} GB" if count < 1e11 else f"{count / 1e9:,.0f} GB"


def read_size(text: str, name: str) -> int:
    """Read a size in bytes, such as `8G`, `500M` or `2.5 GB`, by powers of 1000.

    **Arguments:**

    - `text`: what is read.
    - `name`: what it is the value of.

    **Raises:** `ValueError` that names it, if it is no size above 0.

        >>> from jaxcell.base.memory import read_size
        >>> read_size("2.5G", "memory")
        2500000000
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)B?\s*", text, re.IGNORECASE)
    count = int(float(found[1]) * 1000 ** " KMGT".index(found[2].upper() or " ")) if found else 0
    if not count:
        raise ValueError(f"{name}: expected a size such as 8G or 500M, got {text!r}")
    return count


def _known() -> list[tuple[int, str]]:
    """The bytes that each limit leaves, and the limit in words."""
    return [*_machine(), *_control_groups(), *_addresses(), *_wished()]


def _wished() -> Iterator[tuple[int, str]]:
    """What is left of the limit that the user set, once all libraries are loaded."""
    if text := os.environ.get(LIMIT):
        pages = [int(line.split()[1]) for line in _lines(_PROC / "self" / "statm")]
        taken = sum(pages) * os.sysconf("SC_PAGE_SIZE") if pages else 0
        taken = max(taken, LIBRARIES)
        libraries = f"of which Python and its libraries take {gigabytes(taken)}"
        left = read_size(text, LIMIT) - taken
        yield left, f"--memory or {LIMIT} allows {text.strip()}, {libraries}"


def _machine() -> Iterator[tuple[int, str]]:
    for line in _lines(_PROC / "meminfo"):
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) * 1024, ""
            return
    try:
        yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), ""
    except (ValueError, OSError, AttributeError):
        return


def _control_groups() -> Iterator[tuple[int, str]]:
    """What the limits of this process's control groups leave, and of those that hold them."""
    for folder, most, used, cache in _limits(_PROC, _GROUPS):
        stat = _lines(folder / "memory.stat")
        # Pages of files that nobody uses are given back.
        spare = [int(line.split()[1]) for line in stat if line.startswith(cache + " ")]
        yield (
            most - (_number(folder / used) or 0) + sum(spare),
            f"the control group of this container or batch job allows {gigabytes(most)}",
        )


# To look through the folders takes longer than the images of a small map.
@functools.cache
def _limits(proc: Path, groups: Path) -> list[tuple[Path, int, str, str]]:
    """The control groups with a limit: folder, limit, and the names of what is used and spare."""
    found = []
    for line in _lines(proc / "self" / "cgroup"):
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root, limit, used, cache = groups, "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            root, cache = groups / "memory", "total_inactive_file"
            limit, used = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        # Within a container its own group is at the root.
        here = root / path.strip("/")
        for folder in {root, *(one for one in (here, *here.parents) if root in one.parents)}:
            most = _number(folder / limit)
            if most is not None and most <= _NO_LIMIT:
                found.append((folder, most, used, cache))
    return found


def _addresses() -> Iterator[tuple[int, str]]:
    if sys.platform != "linux":
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        for line in _lines(_PROC / "self" / "statm"):
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
