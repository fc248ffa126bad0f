"""Files of graphs, and of values at their vertices."""
