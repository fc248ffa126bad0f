"""Recordings of attractors and basins."""
