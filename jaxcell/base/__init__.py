"""Basic modules, which all other packages may import."""
