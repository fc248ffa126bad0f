"""The folders of the bundled data, and maps in the text of a script."""

from pathlib import Path

import numpy as np


DATA = Path(__file__).parents[2] / "data"
MAPS = DATA / "maps"
GRAPHS = DATA / "graphs"


def squares(text: str) -> np.ndarray:
    """Read the free squares `.` of a map `[rows, columns]`, whose last line of text is row 0."""
    return np.array([[square == "." for square in row] for row in text.split()[::-1]])
