"""How large the problems are that dense matrices serve."""

MAX_VERTICES = 2_000
"Vertices of a graph, or cells of a map, whose walks are optimised and measured."
