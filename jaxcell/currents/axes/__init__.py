"""The dimensions, times and depths of currents."""
