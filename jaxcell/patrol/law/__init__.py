"""The generalized lambda distribution `Gld` (Alam 2018, Eq. 4.10), and its fit, `fit_gld`.

A fit, `GldFit`, is the distribution with the largest likelihood of samples. If samples are whole
numbers, it is the likelihood of the intervals that the samples stand for.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
