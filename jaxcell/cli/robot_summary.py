from typing import TYPE_CHECKING, Any

from .terminal import configuration, table


if TYPE_CHECKING:
    from .robot_emulation import Emulation


def show(title: str, summary: dict[str, Any], emulation: "Emulation | None" = None) -> None:
    """Prints the outcome of a run for people."""
    observed = summary["observations"]
    rows: list[tuple[str, object]] = [
        ("result", summary["result"]),
        ("why", summary["reason"]),
        ("observed", observed if len(observed) <= 60 else f"{observed[:57]}... ({len(observed)})"),
    ]
    if "visited" in summary:
        rows.append(("visited", f"{len(summary['visited'])} cells"))
    if summary.get("obstacles"):
        sides = ("East", "North", "West", "South")
        met = [f"{sides[way]} of position {at}" for at, way in summary["obstacles"][:8]]
        rows.append(("in the way", "\n".join(met)))
    if emulation is None:
        if summary["cells"]:
            rows.append(("may be in", ", ".join(map(str, summary["cells"][:20]))))
    else:
        truth = summary["emulated"]
        rows.append(("started at", configuration(emulation.cells, truth["start"])))
        end = truth["end"]
        rows.append(("is at", "no cell" if end is None else configuration(emulation.cells, end)))
        if summary["cells"]:
            may = [configuration(emulation.cells, z) for z in summary["cells"][:8]]
            rows.append(("may be at", "\n".join(may)))
            rows.append(
                ("the truth is among them", "yes" if truth["truth_is_a_candidate"] else "NO")
            )
    table(title, ("", ""), rows)
