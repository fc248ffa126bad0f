"""Validation of drift maps: simulated drifters, the distance from them, and coherent structures."""
