"""Boundaries of basins: edge states, refinement, and the number of cells that resolves them."""
