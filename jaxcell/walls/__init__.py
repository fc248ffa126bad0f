"""Sets of possible places on walls, for a robot with a bump sensor, a clock and an unknown start.

A robot that knows neither its place nor its heading drives straight until it meets a wall, turns by
an angle, and drives on (Alam 2018, section 2.3.1). It observes the length of each run. After its
first bump it stands at a wall, so its state is `(wall, arc length p, heading)`. For a fixed
heading, the next wall, the arc length there and the length of the run are piecewise affine in `p`,
with breaks where the ray passes a corner. These pieces are the *chords* of the room. A set of
states is a list of stretches of walls for each heading. If a run is observed to be between `a` and
`b` metres long, the stretches are reduced to the places from which a run can have such a length,
and the affine map carries them to the next walls. Places are never rounded to cells, which would
enlarge the sets.

If the heading is not known exactly, headings are divided into intervals, *slices*, and a chord
bounds the runs of all headings of a slice. Distance and arc length are monotone in the place and in
the heading, so they lie between their values at the ends of a piece and of a slice. Bounds are
moved outward by the tolerance of the map, which covers the rounding of its coordinates, and by the
distance between the arcs around corners and their chords. So a set always contains the robot if its
errors are within their bounds.

A robot may bump into a chair that is not on the map. Then it stands inside the room, as far along
its run as it measured, and its next run begins there. `RelaxedFilter` follows the robots for which
0, 1, ..., `q` bumps were not on the map, so its sets hold each robot with at most `q` such bumps.

No part of this package imports JAX.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
