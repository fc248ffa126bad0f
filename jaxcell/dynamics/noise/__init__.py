"""Markov chains of maps with normal noise."""
