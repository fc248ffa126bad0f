"""Recordings of sweeps, with parameters as timelines."""

from ...base.extras import import_module


import_module("rerun")
