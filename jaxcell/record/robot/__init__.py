"""Recordings of robots that are driven."""

from ...base.optional_modules import import_module


import_module("rerun")
