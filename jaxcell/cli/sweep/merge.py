import dataclasses
import os
import sys
from pathlib import Path
from typing import Annotated

import tyro

from ..terminal import stdout_on_stderr
from .run import show_status, shown


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepMerge:
    """Put the shards of a sweep together, once all of them are done.

    Exit status: 0 all done, 1 some members failed, 2 bad input: a shard that is missing, not done,
    or of another specification."""

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep: its shards are in shards/ there."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object and nothing else."""

    def run(self) -> int:
        # As in `sweep`.
        os.environ.setdefault("JAX_ENABLE_X64", "1")
        sys.path.append(os.getcwd())
        from ...sweep import merge_sweep

        with stdout_on_stderr(), shown(f"merging the shards of {self.folder}") as show:
            found = merge_sweep(self.folder, progress=show)
        show_status(self.folder, found, self.json)
        return 0 if found.complete else 1
