from .graph_files import Graph as Graph, has_weights as has_weights, load_graph as load_graph
from .graph_saving import save_graph as save_graph
from .values import load_stakes as load_stakes, load_values as load_values
