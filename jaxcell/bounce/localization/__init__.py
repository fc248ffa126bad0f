"""Filters and policies that localize a robot, and simulated runs of such robots (chapter 2)."""
