from .graph_files import (
    Graph as Graph,
    Ways as Ways,
    load_graph as load_graph,
    load_ways as load_ways,
)
from .problems import WalkProblem as WalkProblem, load_problem as load_problem
from .values import load_stakes as load_stakes, load_values as load_values
