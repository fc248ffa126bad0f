"""Remarks on a result about drifters: doubts about the answer, in words."""

from typing import TYPE_CHECKING

import numpy as np

from ...base.formatting import in_time


if TYPE_CHECKING:
    from .sea_drift import SeaDrift


# Squares of shorter sides, in metres, are finer than the bundled coastline.
_FINE = 2000.0
# The largest number of remarks that are shown.
_MAX_REMARKS = 4


def remarks_on(drift: "SeaDrift") -> tuple[str, ...]:
    """Describe the doubts about a result, those that change the answer most first."""
    of_layers = [remark for layer in drift.layers for remark in layer.remarks]
    remarks = [*drift.notices, *_coastline(drift), *of_layers]
    if len(remarks) > _MAX_REMARKS:
        more = f"and {len(remarks) - _MAX_REMARKS} more of that kind, at other depths."
        remarks[_MAX_REMARKS:] = [more]
    groups, known = drift.step_sensitivity.groups, drift.step_sensitivity.groups_if_known
    if groups is not None and known is not None and known[1] > groups[1] > 0:
        remarks.append(
            f"At {drift.depths[0]:g} m: by the centres of cells alone there are {known[1]} "
            f"persistent groups in place of {groups[1]}: their number depends on the grid; nearly "
            "closed sets depend on it less."
        )
    if drift.curve is None:
        remarks.append(
            "The numbers of cells that 1, 2, ... drifters can ever reach are left out: they take "
            f"about {drift.curve_seconds / 60:.0f} minutes; jaxcell.drift.coverage_curve computes "
            "them."
        )
    sets = drift.nearly_closed_sets
    if drift.sets_listed and sets is not None and not sets.leakage.size:
        remarks.append(
            "No nearly closed set was found: each part of the water that was tried loses half of "
            f"its drifters or more in {in_time(sets.window_hours)}; --until takes a shorter time."
        )
    voyages = [voyage for voyage in (drift.voyage, drift.surest) if voyage is not None]
    if not all(voyage.policy_certified and voyage.times_certified for voyage in voyages):
        remarks.append(
            "Results of voyages that are not certified exceed 64-bit numbers in some cells, "
            "because an eddy holds drifters almost forever; another duration may avoid this."
        )
    if not drift.answered:
        remarks.append("No policy brings a drifter from the start to the goal.")
    return tuple(remarks)


def _coastline(drift: "SeaDrift") -> tuple[str, ...]:
    """Remark on a bundled coastline that is coarser than the squares of the grid."""
    side, notes = float(np.median(drift.waters[0].sides)), drift.currents.attrs.get("notes", "")
    if side >= _FINE or "Natural Earth" not in notes:
        return ()
    return (
        f"The squares of {side:.3g} m are finer than the bundled coastline, which is off by some "
        "kilometres: islands without data may count as open sea, through which drifters leave the "
        "map; give a finer coastline by --land, or --gaps land.",
    )
