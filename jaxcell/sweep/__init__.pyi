from .results import (
    SweepStatus as SweepStatus,
    open_sweep as open_sweep,
    sweep_status as sweep_status,
)
from .run import run_sweep as run_sweep
from .sensitivity import SobolIndex as SobolIndex, sobol_indices as sobol_indices
from .shards import Shard as Shard, merge_sweep as merge_sweep
from .spec import Spec as Spec
from .verify import Verified as Verified, verify_sweep as verify_sweep
from .workers.engines import engine_named as engine_named, scheduler_address as scheduler_address
from .workers.progress import Progress as Progress
from .workers.work import Failure as Failure
