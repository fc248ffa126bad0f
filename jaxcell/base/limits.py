"""How large the problems are that dense matrices serve."""

MAX_VERTICES = 2_000
"Vertices of a graph whose walks are optimised and measured."

MAX_CELLS = 5_000
"Cells of a map whose patrols are optimised; above `MAX_VERTICES` by steps of first order."
