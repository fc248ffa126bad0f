"""Observed drifters: trajectories, moves between cells, and the chain of the moves."""
