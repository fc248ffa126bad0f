"""Sweeps run one task for many parameters, on one or many machines. Killed runs can be resumed.

A *specification*, a TOML file read by `Spec.load`, names a *task*: a study of jaxcell, or
`module:function`. The tables `[grid]`, `[list]` and `[random]` give the parameters of its
*members*, and `[fixed]` the parameters that all members share. Each parameter of a grid is a
dimension of the result; a list has the dimension `member`, and random samples have the dimension
`sample`. The page "Sweeps" of the documentation has examples. It also describes what follows from
killed runs, damaged files, full disks, failed members, and changed versions.

A task is a function of a *batch* (an array for each parameter, with a value for each member), the
fixed values, and the seed. It returns an `xarray.Dataset` whose variables have `member` as their
first dimension. The values of a member may depend on its parameters and the seed, but not on its
place in the batch or on other members.

`run_sweep` computes the members in *chunks* with an engine (`engine_named`): in this process, in
several processes, or on a Dask cluster (`scheduler_address` reads its address from a file). It
writes to a folder, the *store*, to which only one run at a time can write. `open_sweep` returns the
result: a Dataset with the dimensions above, and a `status` that is 1 for members that are done.
`sweep_status` returns the progress of a sweep, even while it runs. Each job of a job array writes
its own store (`Shard`), and `merge_sweep` merges the stores. `sobol_indices` estimates the share of
the variance that each parameter causes, if the samples have the design `saltelli`. `verify_sweep`
finds damaged data, and computes them again. A sweep can be resumed, enlarged by more values of its
parameters, and moved together with the files that its members read.

This package does not import JAX. Tasks import it.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
