"""Comparisons of results with independent computations.

Each function takes a result and its inputs, and computes a sample of it in the plainest way: one
cell at a time, by exact geometry, dense algebra or a general-purpose solver, and by none of the
functions that made the result. It returns [`jaxcell.verify.Comparison`][]s with the number of
compared numbers, their largest difference, and the difference that rounding may explain.

Samples have a fixed size and are the same each time.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
