"""Optimal random walks, and the searches for them."""
