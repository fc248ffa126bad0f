import dataclasses
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..study.map_study import cell_at
from .options import MapOptions, OutputOptions, starting
from .terminal import configuration, count_cells, status, table


if TYPE_CHECKING:
    from ..automata import Filter
    from ..bounce import Localization
    from ..mapping import PeriodicGroups
    from ..space import CellSpace


FILES = ("groups.nc", "localization.nc", "filter.jxf", "localization.rrd")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(MapOptions, OutputOptions):
    """Build the localization filter of a map, and localize a simulated robot with it."""

    bounce: float
    """Bouncing angle in degrees, counter-clockwise."""
    start: str | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell; else random."""
    seed: int = 0
    """Seed of the random start."""
    open_world: bool = False
    """Give the filter a trap for observations that cannot occur on the map."""

    def run(self) -> int:
        from .. import estimates

        cells = self.cells(lambda e: estimates.localization(e, **self.motion), "localization")
        with starting():
            import numpy as np

            from ..bounce import bounce_groups, bounce_map, localization_filter, localize
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "--start")
        bounce = math.radians(self.bounce)
        spec = {**self.spec(cells), "bounce_deg": self.bounce}
        with status(f"mapping {cells.size:,} cells"):
            simple_map = bounce_map(cells, bounce, **self.motion)
            groups = bounce_groups(cells, bounce, **self.motion)
        began = time.perf_counter()
        with status(f"building the filter of {cells.size:,} cells"):
            filter = localization_filter(simple_map, open_world=self.open_world, metadata=spec)
        seconds = time.perf_counter() - began
        run = localize(simple_map, filter, start)
        with status("minimizing the filter"):
            found = describe(cells, groups, filter, run)
        summary = {**spec, **found, "filter_seconds": round(seconds, 3)}
        if self.out is not None:
            with status(f"writing {self.out}"):
                write(self.out, cells, groups, simple_map.image, filter, run, spec)
        return self.finish(
            summary,
            lambda: show(cells, summary),
            lambda verify: [
                verify.compare_images(cells, simple_map, bounce, **self.motion),
                *verify.compare_groups(np.asarray(simple_map.image), groups),
                verify.compare_filter(simple_map, filter),
            ],
        )


def describe(
    cells: "CellSpace", groups: "PeriodicGroups", filter: "Filter", run: "Localization"
) -> dict[str, Any]:
    """The numbers that a person or a script wants of a localization."""
    from ..automata import minimize

    return {
        "periodic_groups": int(groups.count),
        "longest_transient": int(groups.step.max()),
        "nfa_states": cells.size + 1,
        "dfa_states": len(filter.transition) - filter.open_world,
        "minimal_states": len(minimize(filter).transition) - filter.open_world,
        "open_world": filter.open_world,
        "knowledge_cycles": [
            {"color": c.color, "uncertainty": c.uncertainty, "length": len(c.states)}
            for c in filter.cycles
        ],
        "run": {
            "start": int(run.path[0]),
            "observations": "".join(map(str, run.observations.tolist())),
            "steps": int((run.observations == 0).sum()),
            "bumps": int((run.observations == 1).sum()),
            "end": int(run.path[-1]),
            "candidates": run.candidates.tolist(),
            "truth_is_a_candidate": run.contains_truth,
        },
    }


def show(cells: "CellSpace", summary: dict[str, Any]) -> None:
    """Prints a localization for people."""
    pieces = summary["pieces"]
    table(
        f"{summary['name'] or summary['map']}: bounce {summary['bounce_deg']:g}°",
        ("quantity", "value"),
        [
            ("cells", count_cells(cells)),
            *([("separate pieces of free space", pieces)] if pieces > 1 else []),
            ("periodic groups", summary["periodic_groups"]),
            ("longest transient", summary["longest_transient"]),
            ("states, nondeterministic", summary["nfa_states"]),
            ("states, deterministic", summary["dfa_states"]),
            ("states, minimal", summary["minimal_states"]),
            ("knowledge cycles", len(summary["knowledge_cycles"])),
        ],
    )
    lengths: dict[int, list[int]] = {}
    for cycle in summary["knowledge_cycles"]:
        lengths.setdefault(cycle["uncertainty"].bit_length(), []).append(cycle["length"])
    table(
        "Knowledge cycles",
        ("uncertainty", "cycles", "shortest", "longest"),
        [
            (_doubling(bits), len(some), min(some), max(some))
            for bits, some in sorted(lengths.items())
        ],
    )
    run = summary["run"]
    word = run["observations"]
    candidates = [configuration(cells, z) for z in run["candidates"][:8]]
    more = len(run["candidates"]) - len(candidates)
    table(
        "A simulated robot",
        ("", ""),
        [
            ("started at", configuration(cells, run["start"])),
            ("observed", word if len(word) <= 60 else f"{word[:57]}... ({len(word)} observations)"),
            ("moved", f"{run['steps']} steps and {run['bumps']} bumps"),
            ("is now at", configuration(cells, run["end"])),
            ("may be at", "\n".join(candidates + ([f"and {more} more"] if more else []))),
            ("the truth is among them", "yes" if run["truth_is_a_candidate"] else "NO"),
        ],
    )


def _doubling(bits: int) -> str:
    low, high = 1 << bits - 1, (1 << bits) - 1
    return str(low) if low == high else f"{low} to {high}"


def write(
    out: Path,
    cells: "CellSpace",
    groups: "PeriodicGroups",
    image: Any,
    filter: "Filter",
    run: "Localization",
    spec: dict[str, Any],
) -> None:
    """Writes the groups, the filter and the run, and a recording of all three."""
    from .. import record

    out.mkdir(parents=True, exist_ok=True)
    bounce = math.radians(spec["bounce_deg"])
    dataset = record.groups_dataset(cells, groups, bounce=bounce, image=image, spec=spec)
    record.save_dataset(dataset, out / "groups.nc")
    record.save_dataset(
        record.localization_dataset(cells, filter, run, spec=spec), out / "localization.nc"
    )
    filter.save(out / "filter.jxf")
    record.log_localization(
        out / "localization.rrd", cells, groups, filter, run, bounce=bounce, spec=spec
    )
