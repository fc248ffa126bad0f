"""The layouts of ocean models: velocities on cell faces, and levels."""
