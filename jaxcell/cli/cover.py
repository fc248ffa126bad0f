import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any, Literal

from .options import MapOptions, OutputOptions, starting
from .terminal import count_cells, note, status, steps, table


if TYPE_CHECKING:
    from ..bounce import CoveragePolicy
    from ..space import CellSpace


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cover(MapOptions, OutputOptions):
    """Find the shares of time of bouncing angles with which an imprecise robot covers a map."""

    bounces: tuple[float, ...]
    """Bouncing angles in degrees, counter-clockwise."""
    error: float
    """Largest error of a turn in degrees, a whole number of directions."""
    reliability: float
    """Probability of a turn without error, above 0 and at most 1."""
    target: str = "uniform"
    """What to cover: uniform, an image whose bright parts are worth more, or FILE.nc:VARIABLE."""
    weights: Literal["basin", "size"] = "basin"
    """What persistent groups of an angle weigh: the chance of ending there, or their cells."""
    directions: int | None = 360
    """Number of directions."""

    def run(self) -> int:
        from .. import estimates

        angles = len(self.bounces)
        cells = self.cells(
            lambda e: estimates.coverage(
                e, **self.motion, angles=angles, branches=self._branches(e.directions)
            ),
            "coverage",
        )
        with starting():
            import numpy as np

            from ..bounce import coverage_policy
            from .target import read_target
        target = read_target(cells, self.target)
        spec = {
            **self.spec(cells),
            "bounce_deg": list(self.bounces),
            "error_deg": self.error,
            "reliability": self.reliability,
            "target": self.target,
            "weights": self.weights,
        }
        began = time.perf_counter()
        count = len(self.bounces)
        doing = (
            f"covering {cells.positions:,} positions by {count} angles, {cells.size:,} cells each"
        )
        try:
            with steps(doing, count) as tell:
                policy = coverage_policy(
                    cells,
                    np.radians(self.bounces),
                    float(np.radians(self.error)),
                    self.reliability,
                    target,
                    weights=self.weights,
                    **self.motion,
                    progress=lambda done: tell(done, ""),
                )
        except RuntimeError as error:
            note(f"jaxcell cover: {error}")
            return 1
        seconds = time.perf_counter() - began
        summary = {**spec, **describe(self.bounces, policy), "seconds": round(seconds, 3)}
        if self.out is not None:
            from .. import record

            bounces = np.radians(self.bounces)
            with status(f"writing {self.out}"):
                self.out.mkdir(parents=True, exist_ok=True)
                dataset = record.coverage_dataset(cells, policy, bounces=bounces, spec=spec)
                record.save_dataset(dataset, self.out / "coverage.nc")
                recording = self.out / "coverage.rrd"
                record.log_coverage(recording, cells, policy, bounces=bounces, spec=spec)
        return self.finish(
            summary,
            lambda: show(cells, summary),
            lambda verify: verify.compare_coverage(
                cells,
                policy,
                np.radians(self.bounces),
                float(np.radians(self.error)),
                self.reliability,
                weights=self.weights,
                **self.motion,
            ),
        )

    def _branches(self, directions: int) -> int:
        """How many turns there are at a wall; no more than directions, whatever the error."""
        bins = self.error * directions / 360
        return 1 + 2 * round(min(max(bins, 0), directions)) if math.isfinite(bins) else 1


def describe(bounces: tuple[float, ...], policy: "CoveragePolicy") -> dict[str, Any]:
    """The numbers that a person or a script wants of a coverage policy."""
    policies = zip(
        bounces, policy.alpha, policy.groups, policy.limiting, policy.coverage, strict=True
    )
    return {
        "policies": [
            {
                "bounce_deg": bounce,
                "alpha": float(alpha),
                "persistent_groups": groups.count,
                "persistent_cells": int(groups.size.sum()),
                "positions_visited": int((coverage > 0).sum()),
                "stationarity_residual": limiting.certificate.residual,
            }
            for bounce, alpha, groups, limiting, coverage in policies
        ],
        "distance": policy.distance,
        "total_variation": policy.total_variation,
        "duality_gap": policy.certificate.residual,
        "positions_visited": int((policy.mixture > 0).sum()),
    }


def show(cells: "CellSpace", summary: dict[str, Any]) -> None:
    """Prints a coverage policy for people."""
    pieces = summary["pieces"]
    table(
        f"{summary['name'] or summary['map']}: {count_cells(cells)}"
        + (f", {pieces} separate pieces" if pieces > 1 else ""),
        ("bounce", "share of time", "persistent groups", "their cells", "positions visited"),
        [
            (
                f"{p['bounce_deg']:g}° ± {summary['error_deg']:g}°",
                f"{p['alpha']:.8f}",
                p["persistent_groups"],
                p["persistent_cells"],
                p["positions_visited"],
            )
            for p in summary["policies"]
        ],
    )
    table(
        f"The mixture, against the target {summary['target']}",
        ("quantity", "value"),
        [
            (
                "positions visited in the long run",
                f"{summary['positions_visited']} of {cells.positions}",
            ),
            ("time spent elsewhere than wanted", f"{100 * summary['total_variation']:.1f} %"),
            ("Euclidean distance", f"{summary['distance']:.6g}"),
            (
                "largest stationarity residual",
                f"{max(p['stationarity_residual'] for p in summary['policies']):.1e}",
            ),
            ("duality gap, relative", f"{summary['duality_gap']:.1e}"),
            ("seconds", f"{summary['seconds']:g}"),
        ],
    )
