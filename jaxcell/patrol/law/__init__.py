"""The generalized lambda distribution `Gld` (Alam 2018, Eq. 4.10), and its fit, `fit_gld`.

A fit, `GldFit`, is the law with the largest likelihood of samples, which is that of intervals if
samples are whole numbers.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
