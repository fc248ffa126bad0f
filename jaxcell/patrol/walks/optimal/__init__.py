"""Random walks that are best, and how they are searched for."""
