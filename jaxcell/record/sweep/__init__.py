"""Recordings of sweeps, whose parameters are timelines."""

from .overview import log_sweep as log_sweep
