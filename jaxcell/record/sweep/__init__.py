"""Recordings of sweeps, whose parameters are timelines."""

from ...base.optional_modules import import_module


import_module("rerun")
