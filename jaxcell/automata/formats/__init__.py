"""Filters and policies as files, for other programs and for microcontrollers."""
