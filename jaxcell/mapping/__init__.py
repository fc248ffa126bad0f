"""Simple cell mapping: maps from cells to cells and their global structure.

A simple map `C` sends each of finitely many cells to one image. A cell is *periodic* if some power
of the map brings it back; the orbit of a periodic cell is a *periodic group*, and its length the
*period*. Every other cell is *transient* and reaches exactly one group; all cells that reach a
group are its *basin*, and the number of mappings that a cell needs is its *step* (Hsu 1980; Alam
2018, Definitions 2.3.1 to 2.3.4).

`periodic_groups` finds all of it for any map. Where orbits are known to pass through a smaller set
of cells, a *section*, `section_groups` finds the same from the first-return map to that set.

A generalized map, or Markov *chain*, sends each cell to several images with probabilities. Its
*persistent groups* are its closed communicating classes; the other cells are *transient*, in groups
by their *domiciles*, the persistent groups that they can reach. Nothing here knows of robots.
"""

from .classes import (
    PersistentGroups as PersistentGroups,
    persistent_groups as persistent_groups,
)
from .domiciles import (
    SINK as SINK,
    TransientGroups as TransientGroups,
    transient_groups as transient_groups,
)
from .generalized import Chain as Chain
from .groups import (
    GroupSummary as GroupSummary,
    PeriodicGroups as PeriodicGroups,
    periodic_groups as periodic_groups,
)
from .section import (
    Section as Section,
    SectionGroups as SectionGroups,
    section_groups as section_groups,
)
from .simple import SimpleMap as SimpleMap
