"""Robots with limited sight that patrol a map: policies, regions, and attacks on its cells."""
