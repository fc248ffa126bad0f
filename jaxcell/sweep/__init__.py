"""Sweeps run one task for many parameters, on one or many machines. Kills lose no results.

A *specification*, a TOML file read by `Spec.load`, names a *task* and the parameters of its
*members*:

```toml
task = "groups"            # or "module:function"
seed = 0
chunk = 64                 # members computed together; or {bounce = 16, map = 1}

[fixed]                    # parameters that all members share
directions = 8

[grid]                     # each parameter is a dimension
map = ["@lab_a", "@lab_b"]
bounce = {start = 0, stop = 360, step = 5}

[random]                   # the dimension `sample`; or [list], with the dimension `member`
samples = 100              # with design = "sobol", "latin_hypercube" or "saltelli": evenly spread
cell = {uniform = [0.5, 1.0]}
```

A task is a function of a *batch* (an array for each parameter, with a value for each member), the
fixed values, and the seed. It returns an `xarray.Dataset` whose variables have `member` as their
first dimension. The values of a member may depend on its parameters and the seed, but not on its
place in the batch or on other members.

`run_sweep` computes the members in *chunks* with an engine (`engine_named`): this process, several
processes, or a cluster of Dask, whose address `scheduler_address` reads. It writes to a folder, the
*store*; only one run at a time can write to a store. `open_sweep` returns the result: a Dataset
with a dimension for each parameter, and a `status` that is 1 for members that are done.
`sweep_status` returns the progress of a sweep, even while it runs. Each job of a job array writes
its own store (`Shard`), and `merge_sweep` merges the stores. `sobol_indices` estimates the share of
the variance that each parameter causes, for the design `saltelli`. `verify_sweep` finds damaged
data, and computes them again.

The page "Sweeps" of the documentation describes the behaviour after kills, damage, full disks,
failures of members, and changes of versions.

This package does not import JAX; the tasks do.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
