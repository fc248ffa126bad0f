import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np


class Folder:
    """Arrays over cells in files of a folder, and a record of the work that is done.

    The files have NumPy's format: `numpy.load("basin.npy", mmap_mode="r")` opens a file. A killed
    computation continues from the record, `work.json`.
    """

    def __init__(self, path: str | Path, made_from: str) -> None:
        """Create or open a folder; `made_from` is a digest of the map, the box and the options."""
        self.path = Path(path)
        self.path.mkdir(parents=True, exist_ok=True)
        self._record = self.path / "work.json"
        self.done: dict[str, int] = {}
        "Number of finished cells, or levels, by the kind of work."
        if self._record.exists():
            record = json.loads(self._record.read_text())
            if record["made_from"] != made_from:
                raise ValueError(
                    f"folder: {self.path} has arrays of another map, box or options; give another "
                    "folder, or remove this one"
                )
            self.done = record["done"]
        self._made_from = made_from
        self._arrays: dict[str, np.memmap] = {}

    def array(self, name: str, dtype: Any, size: int) -> np.ndarray:
        """Open the array called `name`, or create it."""
        file = self.path / f"{name}.npy"
        if file.exists():
            array = np.load(file, mmap_mode="r+")
        else:
            array = np.lib.format.open_memmap(file, "w+", dtype, (size,))
        self._arrays[name] = array
        return array.view(np.ndarray)

    def finish(self, work: str, done: int) -> None:
        """Write arrays to disk; record `done`, the number of finished cells or levels of `work`."""
        for array in self._arrays.values():
            array.flush()
        self.done[work] = done
        new = self._record.with_suffix(".new")
        new.write_text(json.dumps({"made_from": self._made_from, "done": self.done}))
        os.replace(new, self._record)

    def parts(self, work: str, size: int, part: int) -> Iterator[slice]:
        """Yield the unfinished slices of `work`, each of `part` cells, and record finished ones."""
        for first in range(self.done.get(work, 0), size, part):
            yield slice(first, min(first + part, size))
            self.finish(work, min(first + part, size))
