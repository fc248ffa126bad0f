"""Filters and policies that localize a robot, and runs of them (chapter 2)."""
