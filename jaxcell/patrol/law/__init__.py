"""Generalized lambda distributions, and their fit to samples."""
