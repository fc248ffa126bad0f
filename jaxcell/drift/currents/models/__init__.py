"""The layouts of ocean models: velocities on the sides of cells, and levels."""
