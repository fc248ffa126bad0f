"""Files of graphs, and of numbers of their vertices."""
