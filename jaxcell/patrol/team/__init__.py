"""Teams of robots on a graph: idleness, news, travel times, charging, and division."""
