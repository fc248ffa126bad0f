"""Robots that slip: maps of fine cells, beliefs, and policies that are certain to arrive."""
