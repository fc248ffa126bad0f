"""Recordings of robots while they drive."""

from ...base.extras import import_module


import_module("rerun")
