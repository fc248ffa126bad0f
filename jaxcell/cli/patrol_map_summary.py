"""What `jaxcell patrol map` tells people and scripts."""

import dataclasses
from typing import TYPE_CHECKING, Any

from .terminal import say, table


if TYPE_CHECKING:
    from ..patrol import Policy
    from ..record import MapPatrol


# An exact cover of more cells may take too long.
_MOST_COVERED = 500
_COVER_SECONDS = 5.0
_MOST_NAMED = 5


def describe(patrol: "MapPatrol") -> dict[str, Any]:
    """The numbers that a person or a script wants of the patrol of a map."""
    import numpy as np

    seen = patrol.visible.sum(axis=1)
    attack, game, open_ = patrol.attack, patrol.game, patrol.contested
    attacks = []
    columns = (attack.attack_times, attack.exact, attack.simulated, attack.fitted)
    rows = zip(*(column.tolist() for column in columns), patrol.capture, strict=True)
    for steps, exact, simulated, fitted, caught in rows:
        told = attack.fit is not None
        weakest = int(open_[caught[open_].argmin()])
        attacks.append(
            {
                "attack_time": steps,
                "exact": exact,
                "simulated": simulated,
                "fitted": fitted if told else None,
                "fit_gap": fitted - exact if told else None,
                "weakest": _cell(patrol, weakest),
                "weakest_capture": float(caught[weakest]),
                "mean_capture": float(caught[open_].mean()),
            }
        )
    return {
        "edges": len(patrol.graph.edges),
        "sight": {
            "mean_cells_seen": float(seen.mean()),
            "least_cells_seen": int(seen.min()),
            "most_cells_seen": int(seen.max()),
            "seen_by_nobody": np.flatnonzero(~patrol.visible.any(axis=0)).tolist(),
        },
        "policies": _policies(patrol),
        "base_station": _base(patrol),
        "reassignment": _reassignment(patrol),
        "target": _cell(patrol, attack.target),
        "target_view": int(attack.view.sum()),
        "target_boundary": int(attack.boundary.sum()),
        "attacks": attacks,
        "fit": _fit(patrol),
        "fit_failure": attack.failure,
        "game": None
        if game is None
        else {
            "attack_time": game.attack_time,
            "strategies": [
                {"share": share, "probability": weight, "capture_alone": least}
                for share, weight, least in zip(
                    game.shares.tolist(),
                    np.asarray(game.commitment.weights).tolist(),
                    game.least.tolist(),
                    strict=True,
                )
            ],
            "value": game.commitment.value,
            "improvement": game.commitment.value - float(game.least.max()),
            "attacked": _cell(patrol, game.attacked),
            "certificate": dataclasses.asdict(game.commitment.certificate),
        },
    }


def show(summary: dict[str, Any]) -> None:
    """Prints the patrol of a map for people."""
    sight, target = summary["sight"], summary["target"]
    unseen = sight["seen_by_nobody"]
    base = summary["base_station"]
    rows = [
        ("robots", f"{summary['robots']}, which see {summary['range_m']:g} m"),
        ("ways between cells", f"{summary['edges']:,}"),
        ("cells seen from a cell, on average", f"{sight['mean_cells_seen']:.1f}"),
        ("cells that nobody can see", _some(unseen)),
    ]
    if base is not None:
        rows.append(("base station", f"{_at(base['cell'])}, sees {base['view']:,} cells"))
    rows.append(("seconds", f"{summary['seconds']:g}"))
    table(
        f"{summary['name'] or summary['map']}: {summary['positions']:,} cells",
        ("quantity", "value"),
        rows,
    )
    _show_policies(summary)
    _show_reassignment(summary)
    table(
        f"Probability of capture at {_at(target)}",
        ("steps", "exact", "simulated", "fitted", "gap of the fit"),
        [
            (
                str(one["attack_time"]),
                f"{one['exact']:.4f}",
                f"{one['simulated']:.4f}",
                "none" if one["fitted"] is None else f"{one['fitted']:.4f}",
                "none" if one["fit_gap"] is None else f"{one['fit_gap']:+.4f}",
            )
            for one in summary["attacks"]
        ],
    )
    if summary["fit_failure"] is not None:
        say(f"No law was fitted: {summary['fit_failure']}")
    table(
        "Probability of capture, where the adversary chooses",
        ("steps", "weakest cell", "caught there", "mean over cells"),
        [
            (
                str(one["attack_time"]),
                _at(one["weakest"]),
                f"{one['weakest_capture']:.4f}",
                f"{one['mean_capture']:.4f}",
            )
            for one in summary["attacks"]
        ],
    )
    game = summary["game"]
    if game is None:
        return
    table(
        f"The best mixture of shares, attacks of {game['attack_time']} steps",
        ("share", "how often", "alone, at its weakest cell"),
        [
            (f"{one['share']:g}", f"{one['probability']:.4f}", f"{one['capture_alone']:.4f}")
            for one in game["strategies"]
        ],
    )
    say(
        f"It catches with probability {game['value']:.4f} at {_at(game['attacked'])}, where the "
        f"adversary attacks: {game['improvement']:.4f} more than the best share alone."
    )


def _show_policies(summary: dict[str, Any]) -> None:
    columns = ["robot", "cells", "cover", "smallest", "ratio", "tour", "commute", "gap"]
    rows = []
    for one in summary["policies"]:
        least, ratio = one["minimum_cover"], one["cover_ratio"]
        row = [
            str(one["robot"]),
            f"{one['cells']:,}",
            str(len(one["cover"])),
            "not known" if least is None else str(least),
            "" if ratio is None else f"{ratio:.2f}",
            "none" if one["tour_steps"] is None else str(one["tour_steps"]),
            f"{one['commute_time']:,.1f}",
            f"{one['certificate']['residual']:.0e}",
        ]
        if one["contact"] is not None:
            row.append(_at(one["contact"]))
        rows.append(row)
    if summary["base_station"] is not None:
        columns.append("reports at")
    table("Policies: covers in cells, tours and commutes in steps", columns, rows)
    for one in summary["policies"]:
        if one["uncovered"]:
            say(f"Robot {one['robot']} cannot see cells {_some(one['uncovered'])}")


def _show_reassignment(summary: dict[str, Any]) -> None:
    after = summary["reassignment"]
    if after is None:
        return
    steps = summary["attacks"][0]["attack_time"]
    table(
        f"Robot {summary['lost']} is lost, as {after['silence_limit']:,} silent steps tell",
        (f"caught within {steps} steps by", "at the weakest cell", "mean over cells"),
        [
            (name, f"{after[key]['least']:.4f}", f"{after[key]['mean']:.4f}")
            for name, key in (
                ("all of them", "before"),
                ("the others, in their old regions", "meanwhile"),
                ("the others, in new regions", "after"),
            )
        ],
    )


def _policies(patrol: "MapPatrol") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for robot, policy in enumerate(patrol.policies):
        shared = patrol.regions is None and found
        least = found[0]["minimum_cover"] if shared else _minimum(patrol, policy)
        found.append(
            {
                "robot": robot,
                "cells": policy.cells.size,
                "cover": policy.cover.tolist(),
                "minimum_cover": least,
                "cover_ratio": None if least is None else policy.cover.size / least,
                "uncovered": policy.uncovered.tolist(),
                "tour_steps": None if policy.tour is None else policy.tour.size,
                "commute_time": policy.commute_time,
                "contact": None if policy.contact is None else _cell(patrol, policy.contact),
                "certificate": dataclasses.asdict(policy.certificate),
            }
        )
    return found


def _minimum(patrol: "MapPatrol", policy: "Policy") -> int | None:
    """How many cells a smallest cover of what a robot walks on has, where that is soon known."""
    import numpy as np

    from ..optimize import minimum_cover

    if policy.cells.size > _MOST_COVERED:
        return None
    sets = patrol.visible[np.ix_(policy.cells, policy.cells)]
    cover = minimum_cover(sets, time_limit=_COVER_SECONDS, throw=False)
    return cover.chosen.size or None if cover.bound == cover.chosen.size else None


def _base(patrol: "MapPatrol") -> dict[str, Any] | None:
    regions = patrol.regions
    if regions is None:
        return None
    return {
        "cell": _cell(patrol, regions.base),
        "view": int(regions.view.sum()),
        "patrolled_by_nobody": int((regions.region < 0).sum()),
        "regions": [regions.cells(k).size for k in range(regions.count)],
    }


def _reassignment(patrol: "MapPatrol") -> dict[str, Any] | None:
    from ..patrol import capture_probabilities

    after = patrol.reassignment
    if after is None:
        return None
    left = [patrol.policies[robot] for robot in sorted(after.robot.tolist())]
    steps = [int(patrol.attack.attack_times[0])]
    found: dict[str, Any] = {
        "silence_limit": after.after,
        "robots": after.robot.tolist(),
        "regions": [after.regions.cells(k).size for k in range(after.regions.count)],
        "commute_times": [policy.commute_time for policy in after.policies],
    }
    for name, policies in (
        ("before", patrol.policies),
        ("meanwhile", left),
        ("after", after.policies),
    ):
        caught = capture_probabilities(patrol.graph, patrol.visible, policies, steps)
        caught = caught[0, patrol.contested]
        found[name] = {"least": float(caught.min()), "mean": float(caught.mean())}
    return found


def _fit(patrol: "MapPatrol") -> dict[str, Any] | None:
    fit = patrol.attack.fit
    if fit is None:
        return None
    return {
        "l1": float(fit.law.l1),
        "l2": float(fit.law.l2),
        "l3": float(fit.law.l3),
        "l4": float(fit.law.l4),
        "log_likelihood": fit.log_likelihood,
        "distance": fit.distance,
    }


def _cell(patrol: "MapPatrol", cell: int) -> dict[str, Any]:
    x, y = patrol.xy[cell].tolist()
    return {"cell": cell, "x": x, "y": y}


def _at(cell: dict[str, Any]) -> str:
    return f"({cell['x']:g}, {cell['y']:g})"


def _some(cells: list[int]) -> str:
    if not cells:
        return "none"
    more = ", ..." if len(cells) > _MOST_NAMED else ""
    return f"{len(cells):,}: " + ", ".join(map(str, cells[:_MOST_NAMED])) + more
