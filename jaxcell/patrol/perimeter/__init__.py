"""Robots on a closed perimeter that all move by tosses of one coin: BMP, DCP and DNCP.

These baselines of Alam 2018, Table 4.1 (Agmon, Kraus and Kaminka 2008), are the members of
`Movement`; a `Perimeter` has segments and robots. The probability of detection is a polynomial in
the probability of heads, `detection_polynomials`; `maximin` finds the best probability of heads and
bounds its error (`Maximin`). `hitting_law` and `mean_hitting_times` compute the distribution and
the mean of the time until a robot is in a segment.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
