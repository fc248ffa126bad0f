"""Whether maps can be trusted: drifters without cells, and coherent structures."""
