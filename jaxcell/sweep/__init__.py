"""Sweeps: one task for many parameters, on one machine or many, in a store that survives crashes.

A *specification*, a TOML file read by `Spec.load`, names a *task* and the parameters of its
*members*:

```toml
task = "groups"            # or "module:function"
seed = 0
chunk = 64                 # members computed together; or {bounce = 16, map = 1}

[fixed]                    # what all members share
directions = 8

[grid]                     # a dimension for each
map = ["@lab_a", "@lab_b"]
bounce = {start = 0, stop = 360, step = 5}

[random]                   # one dimension, `sample`; or [list], with one dimension `member`
samples = 100              # with design = "sobol", "latin_hypercube" or "saltelli": evenly spread
cell = {uniform = [0.5, 1.0]}
```

A task is a function of a *batch*, an array for each parameter with a value for each member, of the
fixed values, and of the seed. It gives an `xarray.Dataset` whose variables have `member` as their
first dimension. What it gives a member may depend on the parameters and the seed, but not on the
place in the batch, nor on the others there.

`run_sweep` computes the chunks by an engine (`engine_named`: this process, several, or Dask, by the
`scheduler_address` of a cluster), and `open_sweep` gives the result: one Dataset with a dimension
for each parameter, and a `status` that is 1 where a member is done. `sweep_status` gives the
progress of a sweep, also while it runs. What they guarantee:

- A chunk is in the store whole or not at all. A run may end at any moment, by a kill or a loss of
    power, and with `resume` another one computes what is missing and no more. Chunks that ended in
    the last second or so are not in the store yet.
- The numbers depend on the specification alone: not on the engine, the number of processes, the
    order in which chunks end, or interruptions. The bytes of the store are the same. A store that
    was begun with another specification, another version of jaxcell or JAX, another module of the
    task, or other contents of the files that parameters name, is refused. (`anyway` goes on, and
    the attribute `resumed_anyway` of the result says with what.)
- A sweep grows: a specification with all members of the one in the store, and others anywhere among
    them, keeps what is done, and the result is that of a run of the larger one from the start.
- Every file of the result has a checksum, and every chunk that is done has all its files.
    `verify_sweep` reads them all, and computes again what is damaged.
- A file holds as many chunks as make 1 MiB, or one that is larger, so that a million members are
    eight files for each number of theirs.
- One run at a time writes to a store. Jobs of an array write to one each (`Shard`), and
    `merge_sweep` makes of these the store of the whole sweep.
- A member that fails is reported with its parameters and does not stop the others: a chunk that
    fails is computed again in halves, and these in halves. A worker that dies is replaced, and with
    a timeout one that takes too long is. Workers that join a cluster while a sweep runs are used.
- Random samples come from the seed, each parameter from a stream of its own, so that one more
    parameter does not change the others; those of a design come from one stream. `sobol_indices`
    says which parameters the variance of the results of the design `saltelli` comes from.
- Chunks have one shape, padded at the edges, so that a task is compiled once for each process;
    halves of one that failed have others. Only a few chunks are in memory at a time.
- Names of files, as the `map` of a built-in task, are relative to the folder of the specification,
    or else to the current one; the store remembers where that folder is. Names such as `@lab_a` are
    those of bundled data. Workers are given whole paths. A task of your own is given what the
    specification says.

Nothing here imports JAX; the tasks do.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
