"""Processes that compute chunks of a sweep, on one machine or many."""
