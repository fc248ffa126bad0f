"""Robots that slip: their map among fine cells, beliefs, and plans that are certain to arrive."""
