"""Sweeps: one task for many parameters, on one machine or many, in a store that survives crashes.

A *specification*, a TOML file, names a *task* and the parameters of its *members*:

```toml
task = "groups"            # or "module:function"
seed = 0
chunk = 64                 # members computed and stored together; or {angle = 16, map = 1}

[fixed]                    # what all members share
directions = 8

[grid]                     # a dimension for each
map = ["data/maps/lab_a.json", "data/maps/lab_b.json"]
angle = {start = 0, stop = 360, step = 5}

[random]                   # one dimension, `sample`; or [list], with one dimension `member`
samples = 100
cell = {uniform = [0.5, 1.0]}
```

A task is a function of a *batch*, an array for each parameter with a value for each member, of the
fixed values, and of the seed. It gives an `xarray.Dataset` whose variables have `member` as their
first dimension. What it gives a member may depend on the parameters and the seed, but not on the
place in the batch, nor on the others there.

`run_sweep` computes the chunks, and `open_sweep` gives the result: one Dataset with a dimension for
each parameter. Nothing here imports JAX; the tasks do.
"""

from .engines import engine_named as engine_named
from .run import (
    Failure as Failure,
    Progress as Progress,
    SweepStatus as SweepStatus,
    open_sweep as open_sweep,
    run_sweep as run_sweep,
    sweep_status as sweep_status,
)
from .spec import Spec as Spec
