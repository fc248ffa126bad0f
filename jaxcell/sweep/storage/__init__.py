"""The files of sweeps: writing, reading and repair."""
