import dataclasses
from pathlib import Path

import tyro

from ..options import Printing, prepare_tasks
from ..terminal import stdout_on_stderr
from .run import show_status, shown


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepMerge(Printing):
    """Put the shards of a sweep together, once all of them are done.

    Exit status: 0 all done, 1 some members failed, 2 bad input: a shard that is missing, not done,
    or of another specification."""

    folder: tyro.conf.Positional[Path]
    """Folder of the sweep: its shards are in shards/ there."""

    def run(self) -> int:
        prepare_tasks()
        from ...sweep import merge_sweep

        with stdout_on_stderr(), shown(f"merging the shards of {self.folder}") as show:
            found = merge_sweep(self.folder, progress=show)
        show_status(self.folder, found, self.json)
        return 0 if found.complete else 1
