"""What a stranger reads beside the pictures of coverage, in Markdown."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bounce import CoveragePolicy
from ..space import CellSpace
from .texts import describe, made_with


_MOST_ROWS = 24


def coverage_text(
    cells: CellSpace,
    policy: CoveragePolicy,
    degrees: Float[np.ndarray, "angles"],
    shown: int,
    spec: Mapping[str, Any],
) -> str:
    """What the heat maps of a mixture show."""
    if degrees.size == 1:
        divides = "Here there is one angle, so all the time goes to it."
    else:
        divides = (
            f"The robot divides its time among **{degrees.size}** angles so that together they "
            "come as near as possible to the **target**."
        )
    visited = int((np.asarray(policy.mixture) > 0).sum())
    left_out = f" (those of the {shown} largest shares)" if shown < degrees.size else ""
    return f"""# Covering a room without knowing where one is

A robot runs straight. Where it bumps it turns by its bouncing angle, but not precisely, and runs
on. In the long run each angle takes it to some places more than to others. {divides}

{describe(cells)}

{_shares(policy, degrees)}

The mixture spends **{100 * policy.total_variation:.1f} %** of its time elsewhere than wanted, and
visits {visited:,} of {cells.positions:,} positions. No other mixture of these angles is nearer in
Euclidean distance ({policy.distance:.4g}).

## How to look

- **The maps** show the share of time in each square, for each angle alone{left_out}, for the
  mixture, and as it was wanted: in multiples of an even share, 1/{cells.positions:,}. Two colours
  make a doubling. Hover over a square to read its class.
- **The bars** are the shares of time of the angles.
- The other tabs show, for one angle, its persistent groups and where the time goes, direction by
  direction; press play, or drag the slider at the bottom.

{made_with(spec)}"""


def directions_text(cells: CellSpace, policy: CoveragePolicy, i: int, degrees: float) -> str:
    """What the pictures of one angle show."""
    groups, limiting = policy.groups[i], policy.limiting[i]
    count, persistent = groups.count, int(groups.size.sum())
    which = "one *persistent group*" if count == 1 else f"one of {count:,} *persistent groups*"
    return f"""# Bouncing by {degrees:.6g}°, imprecisely

Sooner or later the robot is in {which}, {persistent:,} of {cells.size:,} cells in all, and never
leaves. All others are *transient*.

Each map shows one direction at a time; the slider `direction` at the bottom goes through all
{cells.directions}, from East (0) counter-clockwise.

- **Persistent groups**: cells of one colour are of one group, the likeliest to end in first.
- **Time spent**: the limiting distribution, in multiples of an even share, 1/{cells.size:,}.
  One step changes it by {limiting.certificate.residual:.1e} in all.
"""


def _shares(policy: CoveragePolicy, degrees: Float[np.ndarray, "angles"]) -> str:
    alpha = np.asarray(policy.alpha)
    lines = ["| angle | share of time | persistent groups | their cells |"]
    lines.append("| --- | --- | --- | --- |")
    for angle, share, groups in zip(degrees[:_MOST_ROWS], alpha, policy.groups, strict=False):
        lines.append(
            f"| {angle:.6g}° | {share:.6f} | {groups.count:,} | {int(groups.size.sum()):,} |"
        )
    if degrees.size > _MOST_ROWS:
        rest = alpha[_MOST_ROWS:].sum()
        lines.append(f"| {degrees.size - _MOST_ROWS:,} more | {rest:.6f} | | |")
    return "\n".join(lines)
