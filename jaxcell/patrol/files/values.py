import os
import reprlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...base.documents import check_file, checked_number, read_text
from ...base.formatting import did_you_mean
from ...optimize import Stakes


def load_values(
    path: str | os.PathLike[str], names: Sequence[str], *, whole: bool = False
) -> Float[np.ndarray, "vertices"]:
    """Read one number per vertex from a file whose lines have a name and a number.

    **Arguments:** the file, where `#` begins a comment; the names of the vertices; and whether the
    numbers must be whole. **Returns:** the numbers, positive and finite, in the order of the names.

    Durations of attacks on two vertices:

        >>> from jaxcell import examples, patrol
        >>> path = examples.folder() / "times.txt"
        >>> _ = path.write_text("hall 6\\nyard 9\\n")
        >>> patrol.files.load_values(path, ["yard", "hall"]).tolist()
        [9.0, 6.0]
    """
    return _load(Path(path), names, (1,), whole)[:, 0]


def load_stakes(path: str | os.PathLike[str], names: Sequence[str]) -> Stakes:
    """Read the stakes of a game at each of the named vertices.

    Each line has the name of a vertex and one, two or four numbers, the same count on all lines:
    the value of the goods to the patroller, their value to the adversary if it differs, the gain of
    the patroller from a capture, and the penalty of the adversary. `#` begins a comment.
    """
    return Stakes(*_load(Path(path), names, (1, 2, 4), False).T)


def _load(
    path: Path, names: Sequence[str], lengths: tuple[int, ...], whole: bool
) -> Float[np.ndarray, "vertices numbers"]:
    check_file(path, "numbers for each vertex")
    numbers: dict[str, list[float]] = {}
    expected = f"a {'whole ' * whole}number more than 0"
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        at = f"{path}: line {number}"
        # A name may have several words, and its last words may be numbers.
        splits = [(" ".join(words[:-length]), words[-length:]) for length in lengths]
        name, rest = next((split for split in splits if split[0] in names), splits[0])
        if name not in names:
            meant = did_you_mean(name, names)
            raise ValueError(f"{at}: there is no vertex {reprlib.repr(name)}{meant}")
        if name in numbers:
            raise ValueError(f"{at}: the vertex {reprlib.repr(name)} comes twice")
        numbers[name] = [checked_number(at, word, expected, text=True) for word in rest]
        wrong = next((x for x in rest if not float(x) > 0 or (whole and float(x) % 1)), None)
        if wrong is not None:
            raise ValueError(f"{at}: expected {expected}, got {wrong}")
        first = next(iter(numbers.values()))
        if len(rest) != len(first):
            raise ValueError(f"{at}: expected {len(first)} numbers, as before, got {len(rest)}")
    for name in names:
        if name not in numbers:
            raise ValueError(f"{path}: there is no number for vertex {name!r}")
    return np.array([numbers[name] for name in names])
