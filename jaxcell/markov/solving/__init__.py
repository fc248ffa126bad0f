"""Solvers of the linear equations of chains."""
