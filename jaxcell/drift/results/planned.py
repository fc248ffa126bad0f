from collections.abc import Sequence

from ...base import memory
from ...space import estimates
from ..water import Water


def too_large(waters: Sequence[Water], phases: int, largest: int) -> str | None:
    """Explain why the maps of all phases are too large; return `None` if they are not."""
    cells = [phases * water.cells for water in waters]
    needed, available = estimates.drift(cells), memory.free()
    if sum(cells) > largest:
        limit = f"and {largest:,} are as many as take minutes"
    elif available is not None and needed > available:
        limit = (
            f"which need about {memory.gigabytes(needed)} of memory, and "
            f"{memory.shortage(available)}"
        )
    else:
        return None
    return f"The current has {sum(cells):,} cells at its {phases} phases, {limit}"
