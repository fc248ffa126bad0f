"""Robots on a closed perimeter whose moves are all decided by one coin.

A `Perimeter` has segments and robots. The rules of `Movement` are baselines of Alam 2018, Table 4.1
(Agmon, Kraus and Kaminka 2008). Robots move in either direction (BMP), or they move only ahead, and
a turn takes no time (DNCP) or one step (DCP). The probability of detection is a polynomial in the
probability of heads, `detection_polynomials`; `maximin` finds the best probability of heads and
bounds its error (`Maximin`). `hitting_law` and `mean_hitting_times` compute the law and the mean of
the time until a robot is in a segment.

The columns of DCP and DNCP in Table 4.1 are not the means of these models. They fit robots that do
not keep their heading: see `experiments/chapter_4/decentralized.py`.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
