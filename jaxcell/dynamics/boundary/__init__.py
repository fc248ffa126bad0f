"""Boundaries of basins: edge states, refinement, and the number of cells needed to resolve them."""
