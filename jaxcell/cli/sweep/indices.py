import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import tyro

from ... import sweep
from ..output import Printing
from ..terminal import status, table


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepIndices(Printing):
    """Estimate the Sobol indices of a sweep: each parameter's share of the variance of the results.

    Exit status: 0 done, 2 bad input, such as an unfinished sweep, or one of another design."""

    example: ClassVar[str] = "runs/samples"

    folder: tyro.conf.Positional[Path]
    """Folder of a sweep with the design saltelli."""

    def run(self) -> int:
        with status(f"resampling {self.folder}"):
            indices = sweep.sobol_indices(self.folder)
        rows = [dataclasses.asdict(index) for index in indices]
        summary = {"out": str(self.folder), "indices": rows}
        self.report(summary, lambda: show_indices(self.folder, indices))
        return 0


def show_indices(folder: Path, indices: "Iterable[sweep.SobolIndex]") -> None:
    rows = [
        (
            index.variable,
            ", ".join(f"{name} {value}" for name, value in index.at.items()),
            index.parameter,
            _with_interval(index.first_order, index.first_order_interval),
            _with_interval(index.total, index.total_interval),
        )
        for index in indices
    ]
    heads = ("variable", "at", "parameter", "first order (95 %)", "total (95 %)")
    empty = not any(row[1] for row in rows)
    kept = [i for i in range(len(heads)) if i != 1 or not empty]
    title = f"{folder}: Sobol indices"
    table(title, [heads[i] for i in kept], [[row[i] for i in kept] for row in rows])


def _with_interval(value: float, interval: tuple[float, float]) -> str:
    return f"{value:.3f} ({interval[0]:.2f}, {interval[1]:.2f})"
