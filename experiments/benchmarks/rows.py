"""Report a benchmark: a `Row` for each comparison in the table of all benchmarks.

`run.py` (`make bench`) expects that a script `bench_NAME.py`

- has the options of `options(__doc__, ...)`, with `--rows FILE`;
- prints its complete results on standard output;
- ends with `write_rows(arguments.rows, rows)`, where `rows` is its list of `Row`s;
- stops with an error if results differ, or anything else goes wrong;
- takes less than 45 s with its default options; longer parts need `--full`.

`rows_of` makes rows from the timings of `timing.take_turns`. A row made by hand is

    Row("plans", "plans between all pairs", "1,464 cells", 0.016, "scipy, Dijkstra", 0.188)

and one without a peer is `Row("subset", "localization filter", "880,000 cells", 0.7)`.
"""

import argparse
import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxcell.base.paths import replacing


if TYPE_CHECKING:
    from timing import Timing

# The package `experiments` is in the root of the repository.
sys.path.append(str(Path(__file__).parents[2]))


@dataclasses.dataclass(frozen=True)
class Row:
    """The times of our program and of a peer.

    **Arguments:**

    - `benchmark`: the name of the script, without `bench_` and `.py`.
    - `what`: the result of both programs, in few words.
    - `size`: the size of the problem, with its unit.
    - `ours_s`: the median of our seconds.
    - `peer`: the name of the peer and its program; `None` if there is none.
    - `peer_s`: the median of its seconds; `None` if there is no peer, or if the peer fails.
    """

    benchmark: str
    what: str
    size: str
    ours_s: float
    peer: str | None = None
    peer_s: float | None = None

    def __post_init__(self) -> None:
        for name in ("benchmark", "what", "size"):
            value = getattr(self, name)
            if not isinstance(value, str) or not value:
                raise ValueError(f"Row: {name} is {value!r}; expected words")
        if not isinstance(self.peer, str | None):
            raise ValueError(f"Row: peer is {self.peer!r}; expected words or None")
        if self.peer is None and self.peer_s is not None:
            raise ValueError(f"Row: peer_s is {self.peer_s!r}, but there is no peer")
        for name in ("ours_s", "peer_s"):
            value = getattr(self, name)
            if name == "peer_s" and value is None:
                continue
            if not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise ValueError(f"Row: {name} is {value!r}; expected seconds above 0")

    @property
    def ratio(self) -> float | None:
        """The time of the peer divided by our time."""
        return None if self.peer_s is None else self.peer_s / self.ours_s

    def to_json(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), "ratio": self.ratio}

    @classmethod
    def from_json(cls, entry: Any) -> "Row":
        """Make a row from its JSON.

        **Raises:** `ValueError` if `entry` does not have the fields of a row.
        """
        names = {field.name for field in dataclasses.fields(cls)}
        if not isinstance(entry, dict) or set(entry) != names | {"ratio"}:
            raise ValueError(f"a row is {entry!r}; expected the fields {sorted(names)} and ratio")
        return cls(**{name: entry[name] for name in names})


def rows_of(benchmark: str, what: str, size: str, timings: "Mapping[str, Timing]") -> list[Row]:
    """Make a row per peer, or one row without a peer; the first program of `timings` is ours."""
    ours, *peers = (timing.median for timing in timings.values())
    if not peers:
        return [Row(benchmark, what, size, ours)]
    names = list(timings)[1:]
    return [Row(benchmark, what, size, ours, *peer) for peer in zip(names, peers, strict=True)]


def options(doc: str, repeats: int, full: str | None = None) -> argparse.ArgumentParser:
    """Make a parser of the options of all benchmarks.

    **Arguments:**

    - `doc`: the docstring of the script, whose first line is shown by `--help`.
    - `repeats`: default number of turns of each program.
    - `full`: the additions of `--full`; `None` if there is no such option.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=repeats, help="timed turns of each program")
    if full is not None:
        parser.add_argument("--full", action="store_true", help=f"add {full}")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="file for the rows, as JSON")
    return parser


def write_rows(path: Path | None, rows: Sequence[Row]) -> None:
    """Write rows to `path`, unless it is `None`."""
    if path is not None:
        with replacing(path) as file:
            file.write_text(json.dumps([row.to_json() for row in rows], indent=1) + "\n")


def read_rows(path: Path) -> list[Row]:
    """Read the rows of a benchmark.

    **Raises:** `ValueError` if the file has no rows, `OSError` if there is no file.
    """
    try:
        entries = json.loads(path.read_text())
        if not isinstance(entries, list) or not entries:
            raise ValueError("expected a list of rows")
        return [Row.from_json(entry) for entry in entries]
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
