"""Basins of more cells than memory holds: arrays in files, and groups by passes over them."""
