"""Recordings of robots that are driven."""

from ...base.extras import import_module


import_module("rerun")
