"""Boundaries of basins: edge states, finer cells, and the cells that would resolve them."""
