"""Random walks on a graph: their measures, optimal walks, and the game between walks."""
