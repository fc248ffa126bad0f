import numpy as np

from ..patrol.rounds import Guarded
from .comparison import Comparison, sample


_TARGETS, _MOMENTS, _ROUNDS = 8, 20_000, 5_000
# Five standard errors of a share of the moments.
_CHANCE = 0.018


def compare_rounds(guarded: Guarded) -> list[Comparison]:
    """Compare the exposure of targets with attacks at random moments of many rounds."""
    game, random = guarded.game, np.random.default_rng(0)
    chosen = sample(game.targets.size, _TARGETS)
    moments = random.uniform(0, _ROUNDS * max(route.period for route in guarded.routes), _MOMENTS)
    missed = []
    for target, attack in zip(game.targets[chosen], game.attack[chosen], strict=True):
        wait = np.full(_MOMENTS, np.inf)
        for route in guarded.routes:
            for at in np.flatnonzero(route.vertex == target):
                since = (moments - route.arrive[at]) % route.period
                there = since <= route.leave[at] - route.arrive[at]
                wait = np.minimum(wait, np.where(there, 0.0, route.period - since))
        missed.append((wait > attack * (1 + 1e-9)).mean())
    what = "exposure of some targets, by attacks at random moments"
    return [Comparison.close(what, guarded.evaluation.exposure[chosen], missed, _CHANCE)]
