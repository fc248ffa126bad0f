"""Comparisons of results with independent computations.

Each function takes a result and its inputs, and computes a sample of the result by a simple method:
one cell at a time, with exact geometry, dense algebra or a general-purpose solver. It does not call
the functions that made the result. It returns [`jaxcell.verify.Comparison`][]s with the number of
compared values, their largest difference, and a limit for the effect of rounding.

The size of a sample is fixed, and the sample is the same in each call.
"""

from ..base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
