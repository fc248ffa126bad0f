"""Recordings of robots while they drive."""

from ...base.optional_modules import import_module


import_module("rerun")
