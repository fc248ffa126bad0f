"""Optimisation on the simplex of probabilities.

A *mixture* of distributions `a_1, ..., a_k` has weights that are not negative and sum to 1. The one
nearest to a target is a point of the convex hull of the `a_i`, found exactly by an active set.
Every answer comes with a [`jaxcell.certificate.Certificate`][] of how far from the optimum it can
be.
"""

from .mixture import Mixture as Mixture, mixture as mixture
