from pathlib import Path


DATA = Path(__file__).parents[2] / "data"
MAPS = DATA / "maps"
GRAPHS = DATA / "graphs"
