"""Simple and generalized cell mapping: maps from cells to cells, and their global structure.

A simple map `C` sends each of finitely many cells to one image. A cell is *periodic* if a power
of the map returns it to itself. The orbit of a periodic cell is a *periodic group*, and the number
of its cells is the *period*. Every other cell is *transient* and reaches exactly one group. The
cells that reach a group are its *basin*. The *step* of a cell is the number of applications of the
map until the cell is in its group (Hsu 1980; Alam 2018, Definitions 2.3.1 to 2.3.4).

**Simple maps.** The state moves by `e(i+1) = C(e(i))` (Eq. 2.2, 3.4). With `C^m` the `m`-th power,

    z is periodic      if C^m(z) = z for some m >= 1,
    its group          is { z, C(z), ..., C^(K-1)(z) }, K the least such m: the period (Eq. 2.3),
    the step of z      is the least s >= 0 for which C^s(z) is periodic.

Groups are numbered from 0 in the order of their smallest cells. `periodic_groups` finds them, and
works under `jit` and `vmap`. There are six ways to find them, each the fastest for its case:

- a compiled loop over the cells (`walk`, Alg. 2.1, time `O(N)`): maps on a CPU, and batches;
- first the removal of cells without preimage (`peel`): large maps on a CPU with many such cells;
- repeated squaring, `C, C^2, C^4, ...` (`groups`, work `O(N log N)` in `O(log N)` rounds, each over
  all cells at once): maps on an accelerator;
- the first-return map to a section (`section`): one large map with a section that is far smaller;
- the walls of a bouncing robot as the section, one angle at a time
  (`jaxcell.bounce.BounceGroups.by_angle`): groups of maps that do not fit in memory;
- totals from wall to wall, without groups (`jaxcell.bounce.wall_groups`): many angles and rooms.

**Sections.** A *section* is a set of cells that every orbit visits, such as the cells where a robot
bumps. The first-return map to the section has the same groups as the whole map. Together with the
number of applications of the map until each return, it determines the group, step and period of
every cell; see `section_cycles`.

**Generalized maps.** A generalized map, or Markov *chain*, sends each cell to several images with
probabilities. It maps a distribution over the cells, a row vector, by (Eq. 3.5, 5.5)

    p(n+1) = p(n) P,     p_ij >= 0,     sum_j p_ij <= 1;

the rest of a row, up to 1, is the probability of leaving the space for a *sink*. Cell `i` *leads
to* `j` if a power of `P` has a positive entry `ij`. Then (Definitions 3.3.1 to 3.3.3 and 5.4.2)

    a persistent group  is a set of cells that all lead to each other, and to nothing else;
    a transient cell    is a cell in no such group;
    its domiciles       are the persistent groups that it leads to, and the sink if it can leave.

These are properties of the graph of `P` alone: persistent groups are its strongly connected
components without exit. `persistent_groups` finds them in time proportional to the number of edges,
and `transient_groups` finds the domiciles.

Arrays of JAX stay on their device, such as a GPU. But persistent and transient groups are found on
the host, and so are the periodic groups of large maps in the memory of the host.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
