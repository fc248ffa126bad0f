import math

import numpy as np


# The rival predicts from up to this number of earlier observations.
_ORDERS = 8
# The rate of errors of the map that the rival assumes.
_ERRORS = 0.2


class Evidence:
    """The evidence for a map in decibans, tenths of powers of ten: 30 are a factor of 1,000.

    The evidence is the ratio of the probabilities of all observations on the map and for a rival.
    With probability 1/2 the rival is the map, but each observation is the other one with
    probability 0.2. Otherwise it learns: the observations are a Markov chain of an order from 0 to
    8, all equally probable (as in the twice-universal code of Ryabko 1984), whose probabilities are
    estimated as by Krichevsky and Trofimov (1981): if `a` of `n` earlier observations in the same
    context were equal to this one, its probability is `(a + 1/2) / (n + 1)`.

    By Ville's inequality (1939), the evidence of a robot that moves as its map says ever falls to
    `-d` with a probability of at most `10**(-d / 10)`, and that of observations drawn from the
    rival ever reaches `d` with at most this probability. Both hold for any length of a run, and if
    the robot chooses its angles. A robot on another map is neither, so its rate of errors can only
    be measured.

    A robot bumps at each third step. A map that foretells this earns the factor 1,200 in 30 steps,
    and one that foretells nothing loses more, because the rival learns:

        >>> from jaxcell import automata
        >>> right, coin = automata.Evidence(), automata.Evidence()
        >>> for time in range(30):
        ...     right.observe(int(time % 3 == 2), 0.98)
        ...     coin.observe(int(time % 3 == 2), 0.5)
        >>> round(right.decibans), round(coin.decibans)
        (31, -47)
    """

    decibans: float
    "The evidence, positive if the map explains the observations better than the rival."

    def __init__(self) -> None:
        self.decibans = 0.0
        self._orders = np.arange(_ORDERS + 1)
        self._counts = np.full((_ORDERS + 1, 2**_ORDERS, 2), 0.5)
        # The earlier observations as bits, the last one lowest; those before the run are 0.
        self._past = 0
        self._map = 0.0
        shares = np.append(np.full(_ORDERS + 1, 0.5 / (_ORDERS + 1)), 0.5)
        self._rivals = np.log(shares)

    def observe(self, observation: int, expected: float) -> None:
        """Add an observation, 0 or 1, which has the probability `expected` on the map."""
        context = self._past & (2**self._orders - 1)
        counts = self._counts[self._orders, context]
        learned = counts[:, observation] / counts.sum(axis=1)
        self._counts[self._orders, context, observation] += 1
        self._past = (2 * self._past + observation) % 2**_ORDERS
        wrong = (1 - _ERRORS) * expected + _ERRORS * (1 - expected)
        self._rivals += np.log(np.append(learned, wrong))
        self._map += math.log(expected) if expected > 0 else -math.inf
        rival = float(np.logaddexp.reduce(self._rivals))
        self.decibans = 10 / math.log(10) * (self._map - rival)

    @property
    def words(self) -> str:
        """The end of a sentence that says how well the map explains the observations."""
        times = 10 ** (min(abs(self.decibans), 3000) / 10)
        better = "better" if self.decibans >= 0 else "worse"
        return (
            f"the map explains them {float(f'{times:.2g}'):,g} times {better} than a predictor "
            "that learns from them"
        )
