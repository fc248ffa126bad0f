"""The generalized lambda distribution `Gld` (Alam 2018, Eq. 4.10), and its fit, `fit_gld`.

A fit, `GldFit`, is the distribution that maximizes the likelihood of samples. Samples that are
whole numbers may stand for intervals; their likelihood is then the probability of the intervals.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
