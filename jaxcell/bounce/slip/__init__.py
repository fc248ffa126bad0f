"""Robots that slip: their map among fine cells, beliefs, and plans that surely arrive."""
