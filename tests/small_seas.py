"""Small random seas of several layers that end at a sea bed."""

import numpy as np

from jaxcell.drift.layered_cells import Sea
from jaxcell.examples import water
from jaxcell.mapping import Chain


def random_layers(seed, shape=(4, 5), leak=0.0):
    """Water that gets narrower with depth, and drifts that keep to it."""
    draw = np.random.default_rng(seed)
    waters, chains = [], []
    # As many cells for every seed, so that little is compiled.
    dries = draw.permutation(np.prod(shape))
    for layer in range(3):
        wet = np.ones(shape, bool)
        wet.ravel()[dries[: 1 + 3 * layer]] = False
        here = water(wet, float(layer))
        # Most steps are to a neighbour, as far as numbers go.
        near = np.arange(here.cells) + draw.integers(-1, 2, (2, here.cells))
        far = draw.integers(0, here.cells, (2, here.cells))
        image = np.where(draw.random((2, here.cells)) < 0.95, near, far).clip(0, here.cells - 1)
        rho = draw.choice([0.5, 0.8, 1.0], here.cells)
        stays = np.where(draw.random(here.cells) < 0.3, 1 - leak, 1)
        waters.append(here)
        chains.append(Chain(image, np.stack([rho, 1 - rho]) * stays))
    return waters, chains


def random_sea(seed, **options):
    return Sea.of(*random_layers(seed, **options))
