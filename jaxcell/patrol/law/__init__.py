"""The generalized lambda distribution `Gld` (Alam 2018, Eq. 4.10), and its fit, `fit_gld`.

A fit, `GldFit`, is the distribution that maximizes the likelihood of samples. A whole number may
stand for the interval of length 1 around it; its likelihood is then the interval's probability.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
