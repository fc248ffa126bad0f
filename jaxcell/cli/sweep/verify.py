import dataclasses
import json
from pathlib import Path
from typing import ClassVar

import tyro

from ... import sweep
from ..output import Printing
from ..startup import prepare_tasks
from ..terminal import note, status, stdout_on_stderr, table


_MAX_LISTED = 10


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepVerify(Printing):
    """Check a sweep for damage, such as flipped bits or missing files, and repair it.

    Exit status: 0 the sweep is whole, 1 some chunks could not be computed, 2 bad input."""

    example: ClassVar[str] = "runs/rooms"

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    engine: str = "local"
    """Engine that computes chunks: local, processes, dask, or dask://host:port; see sweep."""
    workers: int | None = None
    """Number of processes of the engines processes and dask; by default the number of
    processors."""

    def run(self) -> int:
        prepare_tasks()
        with stdout_on_stderr(), status(f"reading {self.folder}"):
            found = sweep.verify_sweep(self.folder, engine=self.engine, workers=self.workers)
        counts = {"chunks": found.chunks, "recomputed": found.recomputed, "done": found.status.done}
        if self.json:
            damaged = {"damaged": list(found.damaged), "whole": found.whole}
            print(json.dumps({"out": str(self.folder), **counts, **damaged}))
        else:
            done = f"{found.status.done:,} of {found.status.chunks:,}"
            rows: list[tuple[str, object]] = [("chunks checked", found.chunks)]
            rows += [("damaged", len(found.damaged)), ("recomputed", found.recomputed)]
            rows += [("chunks done", done)]
            table(f"{self.folder}: {found.status.task}", ("the sweep", ""), rows)
            for one in found.damaged[:_MAX_LISTED]:
                note(f"damaged: {one}")
            if len(found.damaged) > _MAX_LISTED:
                note(f"... and others: {len(found.damaged) - _MAX_LISTED:,}")
        return 0 if found.whole else 1
