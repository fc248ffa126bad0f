"""Tables 2.1 and 2.2 of Alam 2018: localization filters of two lab environments, side by side.

    python -m experiments.chapter_2.lab_filters

For each environment and bouncing angle: states of the nondeterministic and of the deterministic
I-state automaton, time of the conversion (JFLAP on an Intel Core i7 at 3.6 GHz in the source), and
the fewest and most configurations to which the robot can be localized. Collisions are `endpoint`,
as in the source.

Writes `lab_filters.csv`, and `lab_filters.png` with the periodic groups (Figures 2.8(b) and 2.9(b)
show two of them). Exit status 1 if a row disagrees with the source.
"""

import csv
import dataclasses
import math
import time
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import bounce_groups, bounce_map, localization_filter
from jaxcell.mapping import PeriodicGroups
from jaxcell.space import ENDPOINT, CellSpace, Workspace

from ..shared.data import MAPS
from ..shared.options import experiment_parser, read_options


@dataclasses.dataclass(frozen=True)
class Row:
    """A row of both tables."""

    environment: str
    bounce_deg: int
    nfa_states: int
    dfa_states: int
    seconds: float
    least: int
    most: int
    uncertainties: tuple[int, ...] | None
    "Configurations in each knowledge cycle, where section 2.5.2 tells them."
    groups: int | None
    "Number of periodic groups, where section 2.5.2 tells it."

    def agrees(self, other: "Row") -> bool:
        """Test whether `other` has all numbers of this row, except the time."""
        known = {name: value for name, value in vars(self).items() if value is not None}
        del known["seconds"]
        return all(value == getattr(other, name) for name, value in known.items())


SOURCE = {
    "lab_a": [
        Row("Figure 2.8(a)", 45, 153, 129, 24, 1, 4, (1, 3, 4), groups=1),
        Row("Figure 2.8(a)", 135, 153, 124, 20, 1, 2, None, groups=None),
    ],
    "lab_b": [
        Row("Figure 2.9(a)", 45, 153, 147, 27, 1, 2, None, groups=None),
        Row("Figure 2.9(a)", 135, 153, 202, 71, 1, 1, None, groups=2),
    ],
}


@dataclasses.dataclass(frozen=True)
class Case:
    map: str
    cells: CellSpace
    groups: PeriodicGroups
    source: Row
    ours: Row


def compute(name: str, source: Row) -> Case:
    workspace = Workspace.load(MAPS / f"{name}.json")
    if workspace.cell is None or workspace.directions is None:
        raise ValueError(f"{name}.json: expected the side of a cell and a number of directions")
    cells = CellSpace.of(workspace, workspace.cell, workspace.directions)
    bounce = math.radians(source.bounce_deg)
    simple_map = bounce_map(cells, bounce, motion=ENDPOINT)
    groups = bounce_groups(cells, bounce, motion=ENDPOINT)
    began = time.perf_counter()
    filter = localization_filter(simple_map)
    uncertainties = sorted(cycle.uncertainty for cycle in filter.cycles)
    seconds = time.perf_counter() - began
    ours = Row(
        source.environment,
        source.bounce_deg,
        nfa_states=cells.size + 1,
        dfa_states=len(filter.transition),
        seconds=seconds,
        least=min(uncertainties),
        most=max(uncertainties),
        uncertainties=tuple(uncertainties),
        groups=int(groups.count),
    )
    return Case(name, cells, groups, source, ours)


def report(cases: list[Case]) -> None:
    table = Table(title="States, seconds and configurations: Tables 2.1 and 2.2", box=SIMPLE_HEAD)
    table.add_column("environment and bounce", no_wrap=True)
    for heading in ("NFA", "DFA", "seconds", "localized to", "cycles", "groups"):
        table.add_column(heading, justify="right")
    for case in cases:
        same = "agrees" if case.source.agrees(case.ours) else "DISAGREES"
        for who, row in (
            (f"{case.source.environment}, {case.source.bounce_deg}°", case.source),
            (f"  jaxcell {same}", case.ours),
        ):
            table.add_row(
                who,
                f"{row.nfa_states}",
                f"{row.dfa_states}",
                f"{row.seconds:.2g}",
                f"{row.least} to {row.most}",
                ", ".join(map(str, row.uncertainties or "-")),
                f"{row.groups or '-'}",
            )
        table.add_section()
    Console().print(table)
    print(
        "The source shows its maps as pictures only. lab_a is the one arrangement of up to three\n"
        "rectangles that gives the rows of Figure 2.8(a). lab_b is a stand-in for Figure 2.9(a):\n"
        "one of several maps that give its rows, and perhaps not the one of the source."
    )


def save(cases: list[Case], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        names = [field.name for field in dataclasses.fields(Row)]
        writer = csv.DictWriter(file, ["from", *names])
        writer.writeheader()
        for case in cases:
            writer.writerow({"from": "Alam 2018", **dataclasses.asdict(case.source)})
            writer.writerow({"from": "jaxcell", **dataclasses.asdict(case.ours)})


def draw(cases: list[Case], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    for axes, case in zip(panels.flat, cases, strict=True):
        rows, columns = case.cells.free.shape
        axes.imshow(
            case.cells.free,
            origin="lower",
            cmap="gray",
            vmin=-0.4,
            vmax=1,
            extent=(0, columns, 0, rows),
        )
        axes.set_xticks(range(columns + 1))
        axes.set_yticks(range(rows + 1))
        axes.grid(color="0.85", linewidth=0.6)
        axes.tick_params(length=0, labelbottom=False, labelleft=False)
        step, group = np.asarray(case.groups.step), np.asarray(case.groups.group)
        for number, color in zip(
            range(int(case.groups.count)), ("#0072b2", "#d55e00"), strict=False
        ):
            x, y, theta = case.cells.centre(np.flatnonzero((step == 0) & (group == number)))
            arrows = {"angles": "xy", "scale_units": "xy", "scale": 2.2, "width": 0.006}
            label = f"group {number}, period {len(x)}"
            axes.quiver(x, y, np.cos(theta), np.sin(theta), color=color, label=label, **arrows)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, frameon=False)
        row = case.ours
        axes.set_title(
            f"{case.map}, bounce {row.bounce_deg}°: {row.dfa_states} states, "
            f"localized to {row.least} to {row.most}",
            fontsize=10,
        )
    figure.suptitle(
        "Periodic groups in lab_a (Figure 2.8(a)) and lab_b (a stand-in for Figure 2.9(a))"
    )
    figure.savefig(path, dpi=150)


def main() -> int:
    parser = experiment_parser(__doc__, "runs/chapter_2/lab_filters")
    options = read_options(parser)

    configure_jax()
    cases = [compute(name, row) for name, rows in SOURCE.items() for row in rows]
    report(cases)
    save(cases, options.out / "lab_filters.csv")
    draw(cases, options.out / "lab_filters.png")
    print(f"Data and figure in {options.out}")
    return 0 if all(case.source.agrees(case.ours) for case in cases) else 1


if __name__ == "__main__":
    raise SystemExit(main())
