"""Bouncing robots: straight until a wall, then a turn by the bouncing angle (Alam 2018, chapters 2 and 3)."""

from .dynamics import (
    Moves as Moves,
    bounce_image as bounce_image,
    bounce_map as bounce_map,
    bounce_shift as bounce_shift,
    grid_moves as grid_moves,
    moves as moves,
)
from .groups import (
    bounce_groups as bounce_groups,
    bump_section as bump_section,
    expand_groups as expand_groups,
    group_summary as group_summary,
    runs as runs,
    summarize as summarize,
)
