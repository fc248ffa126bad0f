"""Small parts of results, computed again by another route.

Each function takes a result and what it was made from, and computes a sample of it as plainly as
can be: one cell at a time, by exact geometry, dense algebra or a general-purpose solver, and by
none of the functions that made the result. It returns [`jaxcell.verify.Comparison`][]s, which say
how many numbers were compared, how far they differ, and how much rounding may explain.

Samples are of fixed size and the same each time.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
