import os
import reprlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...base.documents import check_file, checked_number, read_text


def load_values(
    path: str | os.PathLike[str], names: Sequence[str]
) -> Float[np.ndarray, "vertices"]:
    """Read a number for each vertex: a file of lines with a name and a number.

    **Arguments:**

    - `path`: the file; `#` begins a comment.
    - `names`: of the vertices.

    **Returns:** the numbers, positive and finite, in the order of the names.

    **Raises:** `ValueError` that names the file and the line, for one that is something else, a
    vertex that does not exist, comes twice, or is missing; `FileNotFoundError`.

    Attacks on two vertices:

        >>> import pathlib, tempfile
        >>> from jaxcell import patrol
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "times.txt")
        ...     _ = path.write_text("hall 6\\nyard 9\\n")
        ...     patrol.load_values(path, ["yard", "hall"]).tolist()
        [9.0, 6.0]
    """
    path = Path(path)
    check_file(path, "a number for each vertex")
    place, found = {name: i for i, name in enumerate(names)}, np.full(len(names), np.nan)
    for number, line in enumerate(read_text(path).splitlines(), 1):
        name, _, value = line.partition("#")[0].strip().rpartition(" ")
        if not value:
            continue
        at = f"{path}: line {number}"
        if name.strip() not in place:
            raise ValueError(f"{at}: there is no vertex {reprlib.repr(name.strip())}")
        vertex = place[name.strip()]
        if not np.isnan(found[vertex]):
            raise ValueError(f"{at}: the vertex {reprlib.repr(name.strip())} comes twice")
        found[vertex] = checked_number(at, value, "a number more than 0", text=True)
        if not found[vertex] > 0:
            raise ValueError(f"{at}: expected a number more than 0, got {value}")
    if np.isnan(found).any():
        missing = names[int(np.argmax(np.isnan(found)))]
        raise ValueError(f"{path}: there is no number for vertex {missing!r}")
    return found
