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

    Exit status: 0 the sweep is intact, 1 some chunks could not be computed, 2 bad input."""

    example: ClassVar[str] = "runs/rooms"

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep."""
    engine: str = "local"
    """Engine for the chunks: local, processes, dask, or dask://host:port; see `jaxcell sweep`."""
    workers: int | None = None
    """Number of worker processes if --engine is processes or dask; by default one per processor."""

    def run(self) -> int:
        prepare_tasks()
        with stdout_on_stderr(), status(f"reading {self.folder}"):
            checked = sweep.verify_sweep(self.folder, engine=self.engine, workers=self.workers)
        counts = {
            "chunks": checked.chunks,
            "recomputed": checked.recomputed,
            "done": checked.status.done,
        }
        if self.json:
            damaged = {"damaged": list(checked.damaged), "whole": checked.whole}
            print(json.dumps({"out": str(self.folder), **counts, **damaged}))
        else:
            done = f"{checked.status.done:,} of {checked.status.chunks:,}"
            rows: list[tuple[str, object]] = [("chunks checked", checked.chunks)]
            rows += [("damaged", len(checked.damaged)), ("recomputed", checked.recomputed)]
            rows += [("chunks done", done)]
            table(f"{self.folder}: {checked.status.task}", ("the sweep", ""), rows)
            for damage in checked.damaged[:_MAX_LISTED]:
                note(f"damaged: {damage}")
            if len(checked.damaged) > _MAX_LISTED:
                note(f"... and others: {len(checked.damaged) - _MAX_LISTED:,}")
        return 0 if checked.whole else 1
