"""Random walks on a graph: what they measure, the best of them, and the game between them."""
