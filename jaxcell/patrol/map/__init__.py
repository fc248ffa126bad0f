"""Robots that patrol a map and see only so far: policies, regions, and attacks on its cells."""
