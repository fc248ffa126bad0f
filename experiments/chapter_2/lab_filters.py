"""Tables 2.1 and 2.2 of Alam 2018: localization filters of two labs, beside those of the source.

    python -m experiments.chapter_2.lab_filters

For each lab and bouncing angle, the table has the numbers of states of the nondeterministic (NFA)
and of the deterministic I-state automaton (DFA), the time of the conversion (the source used JFLAP
on an Intel Core i7 at 3.6 GHz), and the least and largest number of configurations to which the
robot can be localized. Collisions are `endpoint`, as in the source.

The script writes `lab_filters.csv`, and `lab_filters.png` with the periodic groups (Figures 2.8(b)
and 2.9(b) show two of them). The exit status is 1 if a row disagrees with the source.
"""

import dataclasses
import math
import time
from pathlib import Path

import numpy as np

from jaxcell.base.runtime import configure_jax
from jaxcell.bounce import bounce_groups, bounce_map, localization_filter
from jaxcell.mapping import PeriodicGroups
from jaxcell.space import ENDPOINT, CellSpace

from ..shared.data import MAPS
from ..shared.figures import draw_room, plt, save
from ..shared.options import experiment_parser, read_options
from ..shared.report import show, write_csv


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
    "Number of configurations in each knowledge cycle, or `None` if section 2.5.2 does not have it."
    groups: int | None
    "Number of periodic groups, or `None` if section 2.5.2 does not have it."

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
    """Compute our row beside a row of the source."""
    cells = CellSpace.load(MAPS / f"{name}.json")
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
    """Print the rows of the source, each with our row below it."""
    rows = []
    for case in cases:
        same = "agrees" if case.source.agrees(case.ours) else "DISAGREES"
        who = f"{case.source.environment}, {case.source.bounce_deg}°"
        for name, row in ((who, case.source), (f"  jaxcell {same}", case.ours)):
            rows.append(
                {
                    "environment and bounce": name,
                    "NFA": row.nfa_states,
                    "DFA": row.dfa_states,
                    "seconds": float(row.seconds),
                    "localized to": f"{row.least} to {row.most}",
                    "cycles": ", ".join(map(str, row.uncertainties or "-")),
                    "groups": f"{row.groups or '-'}",
                }
            )
    show("States, seconds and configurations: Tables 2.1 and 2.2", rows, ".2g")
    print(
        "The source shows its maps as pictures only. lab_a is the only arrangement of up to three\n"
        "rectangles that gives the rows of Figure 2.8(a). lab_b replaces Figure 2.9(a): it is one\n"
        "of several maps that give its rows, and may differ from the map of the source."
    )


def draw(cases: list[Case], path: Path) -> None:
    """Draw the periodic groups of each case on its map."""
    figure, panels = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    for axes, case in zip(panels.flat, cases, strict=True):
        draw_room(axes, case.cells.free, grid=True)
        step, group = np.asarray(case.groups.step), np.asarray(case.groups.group)
        for number, color in enumerate(("#0072b2", "#d55e00")[: int(case.groups.count)]):
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
        "Periodic groups in lab_a (Figure 2.8(a)) and lab_b (in place of Figure 2.9(a))"
    )
    save(figure, path)


def main() -> int:
    options = read_options(experiment_parser(__doc__, "runs/chapter_2/lab_filters"))
    configure_jax()
    cases = [compute(name, row) for name, rows in SOURCE.items() for row in rows]
    report(cases)
    both = [
        (who, row) for c in cases for who, row in (("Alam 2018", c.source), ("jaxcell", c.ours))
    ]
    rows = [{"from": who, **dataclasses.asdict(row)} for who, row in both]
    write_csv(rows, options.out / "lab_filters.csv")
    draw(cases, options.out / "lab_filters.png")
    print(f"Data and figure in {options.out}")
    return 0 if all(case.source.agrees(case.ours) for case in cases) else 1


if __name__ == "__main__":
    raise SystemExit(main())
