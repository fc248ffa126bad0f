"""The files of sweeps: what is written, and how it is read and mended."""
