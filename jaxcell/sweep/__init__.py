"""Sweeps: one task for many parameters, on one or many machines, in a store that survives kills.

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

A task is a function of a *batch* (an array for each parameter, with a value for each member), of
the fixed values, and of the seed. It returns an `xarray.Dataset` whose variables have `member` as
their first dimension. The values of a member may depend on its parameters and the seed, but not on
its place in the batch or on other members.

`run_sweep` computes the chunks by an engine (`engine_named`: this process, several processes, or
Dask, at the `scheduler_address` of a cluster). `open_sweep` returns the result: one Dataset with a
dimension for each parameter, and a `status` that is 1 for members that are done. `sweep_status`
returns the progress of a sweep, also while it runs. They guarantee:

- Each chunk that ends is appended to the journal of the store, with a checksum. A run may end at
    any moment, also by a kill, and a run with `resume` computes only the rest. A loss of power may
    lose the chunks of the last seconds.
- The result is a Zarr store that is made of the journal when a run ends, and may be larger than the
    memory. Its bytes depend on the specification alone: not on the engine, the number of processes,
    the order in which chunks end, or interruptions.
- A resume is refused if the specification, the version of jaxcell or JAX, the module of the task,
    or a file that parameters name has changed. (`anyway` continues, and the attribute
    `resumed_anyway` of the result lists the changes.)
- A sweep grows: if a specification has all members of the sweep in the store, and others anywhere
    among them, only the others are computed.
- `verify_sweep` reads all records and files, and computes again what is damaged.
- A file of the result holds chunks of 1 MiB together, so a million members are eight files for each
    variable.
- One run at a time writes to a store. The jobs of an array write to a store each (`Shard`), and
    `merge_sweep` merges these.
- A member that fails is reported with its parameters and does not stop others: a chunk that fails
    is computed again in halves, and these in halves. A worker that dies is replaced, and with a
    timeout a worker that takes too long is too. Workers may join a cluster while a sweep runs.
- Random samples come from the seed. Each parameter has its own stream of random numbers, so an
    additional parameter does not change the others; the points of a design have one common stream.
    `sobol_indices` estimates the shares of the variance that come from the parameters of the design
    `saltelli`.
- All chunks have one shape, padded at the edges, so that each process compiles a task once; halves
    of a failed chunk have other shapes. Only a few chunks are in memory at a time.
- Paths of files, such as the `map` of a built-in task, are relative to the folder of the
    specification, or else to the current one; the store remembers that folder. `@lab_a` is a file
    of the bundled data. Workers get absolute paths. A task of your own gets the paths as they are.

This package does not import JAX; the tasks do.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
