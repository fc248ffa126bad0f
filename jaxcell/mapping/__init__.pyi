from .classes import (
    PersistentGroups as PersistentGroups,
    persistent_groups as persistent_groups,
)
from .domiciles import (
    SINK as SINK,
    TransientGroups as TransientGroups,
    transient_groups as transient_groups,
)
from .generalized import Chain as Chain, ChainLike as ChainLike
from .groups import (
    GroupSummary as GroupSummary,
    GroupTotals as GroupTotals,
    PeriodicGroups as PeriodicGroups,
)
from .peel import periodic_groups as periodic_groups
from .section import (
    Section as Section,
    SectionCycles as SectionCycles,
    section_cycles as section_cycles,
)
from .sequence import ChainSequence as ChainSequence
from .simple import SimpleMap as SimpleMap
