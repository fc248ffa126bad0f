"""Basins with more cells than fit into memory: arrays in files, and passes over the files."""
