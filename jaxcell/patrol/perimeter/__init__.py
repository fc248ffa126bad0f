"""Robots on a cycle that toss one coin: BMP, DCP and DNCP of Alam 2018, Table 4.1.

These baselines (Agmon, Kraus and Kaminka 2008) are the members of `Movement`; a `Perimeter` has
segments and robots. The probability of detection is a polynomial in the probability of heads,
`detection_polynomials`; `maximin` finds the best one, a `Maximin` with a bound. `hitting_law` and
`mean_hitting_times` give the time until a robot is in a segment, and `simulate` draws it.
"""

from ...base.hosted import attach


__getattr__, __dir__, __all__ = attach(__name__, __file__)
