"""Basins of more cells than memory holds: arrays in files, and passes over the files."""
