"""Recordings of sweeps, whose parameters are timelines."""

from ...base.extras import import_module


import_module("rerun")
