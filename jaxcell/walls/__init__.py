"""Sets of places on walls: where a robot with a bump sensor and a clock is, from any start.

A robot that knows neither its place nor its heading drives straight until it meets a wall, turns by
an angle, and drives on (Alam 2018, section 2.3.1). It observes how far each run is. After its first
bump it stands at a wall, so its state is `(wall, arc length p, heading)`. For a fixed heading the
wall that it meets next, the arc length there and the length of the run are piecewise affine in `p`,
with breaks where the ray passes a corner: these pieces are the *chords* of the room. A set of
states is, for each heading, a list of stretches of walls. A run observed to be between `a` and `b`
metres cuts the stretches to the part from which a run can be so long, and the affine map carries
them to the next walls. Nothing is ever put back on cells, so sets do not grow.

Where headings are not known, a chord is that of a *slice* of headings, and holds all that robots of
the slice may do: distance and arc length are monotone in the place and in the heading, so the four
corners of a stretch and a slice bound them. Bounds are moved outward by more than rounding can be.
So a set always has the robot in it, as long as its errors are within their bounds.

No part of this package imports JAX.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
