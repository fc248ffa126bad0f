"""Drifters: where the water of an ocean current carries what floats in it (Alam 2018, chapter 5).

The sea is cut into cells, in one or more layers. A *drifter* in a layer moves with the current; it
chooses at most its depth.

- The *flow map* sends a point to where the current has carried it after a time `dt`. The *image* of
    a cell is the water cell that is nearest to the end of the flow line from its centre.
- The current is not known exactly. With probability `rho` the image is right; what is left goes to
    the other cells of a bounded *disturbance set* `A(z)`. So the sea becomes a finite Markov chain
    over cells, a generalized cell map; what leaves the domain goes to an explicit sink.
- A *persistent group* is a closed communicating class of that chain: drifters that enter it stay.
    Every other cell is *transient*. The *domicile* of a transient cell is the set of the persistent
    groups that it can reach: one (single-domicile) or several (multiple-domicile).
- The *absorption time* of a transient cell is the expected number of steps until its drifter is in
    a persistent group, and its *absorption probabilities* say in which.
- A *deployment* is a set of cells to release drifters in, so that in the long term they reach every
    cell that any drifter can: one in each persistent group, and more that cover the transient ones.
- A *voyage* is a drifter's way to a goal by going up, going down, or drifting, chosen in each cell
    by the *policy* of a Markov decision process.

`open_currents` reads the currents: velocities towards the East (`u`) and North (`v`) in metres per
second, the mask of the water, and the sides of the cells in metres.
"""

from .ocean import open_currents as open_currents
