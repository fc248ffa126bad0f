"""Results for one layer of a current, and for all layers."""
