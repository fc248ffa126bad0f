import dataclasses
from typing import TYPE_CHECKING, Any

from .options import MapOptions, OutputOptions, starting
from .terminal import count_cells, status, table


if TYPE_CHECKING:
    from ..mapping import GroupSummary
    from ..space import CellSpace
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Groups(MapOptions, OutputOptions):
    """Find the periodic groups of a bouncing robot and how every cell reaches them."""

    bounce: tuple[float, ...]
    """Bouncing angles in degrees, counter-clockwise; several make one batched run."""

    def run(self) -> int:
        from .. import estimates

        if not self.bounce:
            raise ValueError("--bounce: expected at least one angle in degrees")
        cells = self.cells(
            lambda e: (
                estimates.images(e, len(self.bounce), **self.motion)
                if self.verify or self.out is not None
                else estimates.groups(e, **self.motion)
            ),
            "groups",
        )
        with starting():
            import numpy as np

            from ..bounce import bounce_groups, bounce_map, group_summary
        angles = np.radians(self.bounce)
        with status(f"mapping {len(angles)} x {cells.size:,} cells"):
            found = group_summary(cells, angles, **self.motion)
        spec = {**self.spec(cells), "bounce_deg": list(self.bounce)}
        summary = {**spec, "groups": []}
        for i, angle in enumerate(self.bounce):
            count = int(found.count[i])
            period, basin, transient = (
                np.asarray(x)[i, :count] for x in (found.period, found.basin, found.transient)
            )
            summary["groups"].append(
                {
                    "bounce_deg": angle,
                    "count": count,
                    "longest_transient": int(transient.max()),
                    "shortest_period": int(period.min()),
                    "longest_period": int(period.max()),
                    "periodic_cells": int(period.sum()),
                    "largest_basin": int(basin.max()),
                }
            )
        if self.out is not None:
            from .. import record

            with status(f"writing {self.out}"):
                groups = bounce_groups(cells, angles, **self.motion)
                image = bounce_map(cells, angles, **self.motion).image
                self.out.mkdir(parents=True, exist_ok=True)
                dataset = record.groups_dataset(
                    cells, groups, bounce=angles, image=image, spec=spec
                )
                record.save_dataset(dataset, self.out / "groups.nc")
                record.log_groups(self.out / "groups.rrd", cells, groups, bounce=angles, spec=spec)
        return self.finish(
            summary,
            lambda: show(cells, summary),
            lambda verify: self._compare(verify, cells, found),
        )

    def _compare(
        self, verify: Any, cells: "CellSpace", found: "GroupSummary"
    ) -> "list[Comparison]":
        """The images and groups of cells for each angle, and what was told of the groups."""
        import jax
        import numpy as np

        from ..bounce import bounce_groups, bounce_map

        compared = []
        for i, angle in enumerate(np.radians(self.bounce).tolist()):
            mapped = bounce_map(cells, angle, **self.motion)
            groups = bounce_groups(cells, angle, **self.motion)
            told = jax.tree.map(lambda values, i=i: values[i], found)
            compared.append(verify.compare_images(cells, mapped, angle, **self.motion))
            compared += verify.compare_groups(np.asarray(mapped.image), groups, told)
        return compared


def show(cells: "CellSpace", summary: dict[str, Any]) -> None:
    """Prints the groups for people."""
    pieces = summary["pieces"]
    table(
        f"{summary['name'] or summary['map']}: {count_cells(cells)}"
        + (f", {pieces} separate pieces" if pieces > 1 else ""),
        ("bounce", "groups", "longest transient", "periods", "periodic cells", "largest basin"),
        [
            (
                f"{g['bounce_deg']:g}°",
                g["count"],
                g["longest_transient"],
                f"{g['shortest_period']} to {g['longest_period']}",
                g["periodic_cells"],
                g["largest_basin"],
            )
            for g in summary["groups"]
        ],
    )
