from typing import Any

import numpy as np

from .boundary.resolution import AGREE, Trial
from .imaging import remark_of_torn


# The largest number of remarks on single attractors.
_MOST_DOUBTED = 5


def remarks_on(basins: Any) -> tuple[str, ...]:
    """List reasons to doubt [`Basins`][jaxcell.dynamics.Basins], with remedies."""
    remarks = [remark_of_torn(basins.names[axis]) for axis in basins.torn]
    if basins.self_images > 0.1:
        remarks.append(
            f"{basins.self_images:.0%} of the cells are their own images: the time of a mapping "
            "is too short for these cells."
        )
    elif basins.periodic_cells > 0.5 * basins.box.size:
        remarks.append(
            f"{basins.periodic_cells / basins.box.size:.0%} of the cells are periodic: the map "
            "seems to preserve volumes, so that it has groups and no attractors."
        )
    if basins.changed is not None and basins.changed > 0.2:
        remarks.append(
            f"{basins.changed:.0%} of the images differ with steps of half the length: take "
            "shorter steps."
        )
    if basins.trial is not None:
        remarks.append(_disagreement(basins, basins.trial))
    # Three standard errors of the sampled shares.
    doubt = 3 * np.sqrt(basins.sampled * (1 - basins.sampled) / len(basins.starts)) + 0.02
    doubted = np.flatnonzero(np.abs(basins.fraction - basins.sampled) > doubt)
    advice = ""
    if basins.trial is None:
        advice = ": take basins by orbits, or more cells"
        if basins.left.any():
            advice += "; if orbits leave the box and come back, a larger `follow`"
    for k in doubted[:_MOST_DOUBTED]:
        remarks.append(
            f"Attractor {k} has {basins.fraction[k]:.1%} of the cells, but {basins.sampled[k]:.1%} "
            f"of the orbits from random starts end on it{advice}."
        )
    if doubted.size > _MOST_DOUBTED:
        remarks.append(f"The same holds for {doubted.size - _MOST_DOUBTED} more attractors.")
    if basins.neutral:
        remarks.append(
            "Orbits had not settled: some are back where they were, but a direction there neither "
            "attracts nor repels, as with a conserved quantity, or a continuum of points or "
            "cycles. The number of attractors depends on the cells."
        )
    elif not basins.settled:
        remarks.append(
            "Orbits had not settled: some do not approach an attractor exponentially, but with "
            "powers of time, as at a bifurcation or where an attractor has just vanished, or too "
            "slowly to tell. The attractors may be smaller, or not exist: take longer mappings, "
            "or finer cells for an orbit within a cell. A map that preserves volumes has no "
            "attractors."
        )
    none = basins.share(
        lambda part: (
            (basins.basin[part] < 0) & ~basins.left[part] & (basins.group[part] < basins.groups)
        )
    )
    if none > 0.05:
        remarks.append(
            f"{none:.0%} of the cells lead to groups whose orbits reach none of these "
            "attractors, or no finite point: take longer mappings, a smaller box, or a "
            "section to which flows return."
        )
    if basins.several_share > 0.05:
        remarks.append(
            f"{basins.several_share:.0%} of the cells lead to groups from which orbits end on "
            f"several attractors{advice}."
        )
    return tuple(remarks)


def _disagreement(basins: Any, trial: Trial) -> str:
    """Describe how often cells and orbits lead to different attractors, and name a remedy."""
    along = " x ".join(map(str, basins.box.cells))
    remark = (
        f"{basins.disagreement:.0%} of the random starts end elsewhere than their cells lead "
        f"({along} cells)"
    )
    if trial.follow is None:
        return f"{remark}, and basins by orbits disagree, too: take longer mappings."
    orbits = "take basins by orbits, which agree"
    if trial.follow > basins.follow:
        orbits += f" if points are followed outside the box (follow={trial.follow})"
    if not trial.wrong:
        return f"{remark}: {orbits}."
    finer = " and ".join(f"{share:.0%}" for share in trial.wrong[1:])
    remark = f"{remark}; with cells of half and a quarter of the width, {finer} of {trial.points:,}"
    if trial.cells is None:
        return f"{remark}: {orbits}; finer cells would not."
    cells = " x ".join(map(str, trial.cells))
    return f"{remark}: {orbits}, or about {cells} cells, which would leave {AGREE:.0%}."
