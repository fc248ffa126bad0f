"""Drifters that were observed: reading them, and counting how they move."""
