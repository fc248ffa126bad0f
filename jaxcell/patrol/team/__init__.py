"""Several robots on a graph: idleness, news, travel times, and who walks where."""
