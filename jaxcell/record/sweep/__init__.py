"""Recordings of sweeps, with parameters as timelines."""

from ...base.optional_modules import import_module


import_module("rerun")
