"""Graph files of patrolling_sim, the ROS simulator of patrols (Portugal and Rocha)."""

from typing import NamedTuple

from ...base.documents import refused


class SimulatorGraph(NamedTuple):
    """The parts of a file, with lengths in metres."""

    vertices: list[tuple[str, str, float, float]]
    "The place in the file, the name, and the position of each vertex."
    edges: list[tuple[str, str, str, float]]
    "The place in the file, the names of the ends, and the length of each edge."


def parse_simulator_graph(text: str) -> SimulatorGraph:
    """Parse the text of a `.graph` file of patrolling_sim.

    The head is the number of vertices, the width and height of the picture, metres per pixel, and
    the offset of its origin. Each vertex has a number, two coordinates in pixels, the number of its
    neighbours, and for each neighbour its number, a direction (N, SE, ...) and the length of the
    path in pixels.

    **Raises:** `ValueError` that names the wrong word: also for a path whose length differs by
    direction, and for words after the last vertex.
    """
    words = text.split()
    at = 0

    def word() -> str:
        nonlocal at
        at += 1
        if at > len(words):
            raise ValueError(f"it ends after {len(words)} words; expected more; is it truncated?")
        return words[at - 1]

    def number(what: str) -> float:
        given = word()
        try:
            value = float(given)
        except ValueError:
            raise refused(f"word {at}", what, given) from None
        if not abs(value) <= 1e9:
            raise refused(f"word {at}", what, given)
        return value

    def count(what: str) -> int:
        value = number(what)
        if value < 0 or value != int(value):
            raise refused(f"word {at}", what, words[at - 1])
        return int(value)

    total = count("the number of vertices")
    for _ in range(2):
        number("a size in pixels")
    scale = number("the metres per pixel")
    if scale <= 0:
        raise refused(f"word {at}", "more than 0 metres per pixel", words[at - 1])
    right, up = number("an offset in metres"), number("an offset in metres")
    vertices: list[tuple[str, str, float, float]] = []
    lengths: dict[tuple[str, str], tuple[str, float]] = {}
    for _ in range(total):
        name, field = str(count("the number of a vertex")), f"word {at}"
        x, y = number("a coordinate in pixels"), number("a coordinate in pixels")
        vertices.append((field, name, x * scale + right, y * scale + up))
        for _ in range(count("the number of neighbours")):
            other, place = str(count("the number of a neighbour")), f"word {at}"
            word()
            length = number("the length of a path in pixels") * scale
            back = lengths.get((other, name))
            if back is not None and back[1] != length:
                raise ValueError(
                    f"{place}: from vertex {name} to {other} it is {length:g} m, and "
                    f"{back[1]:g} m back; expected equal lengths in both directions"
                )
            lengths[name, other] = place, length
    if at < len(words):
        raise ValueError(f"word {at + 1}: {words[at]!r} comes after the last of {total} vertices")
    edges = [
        (field, name, other, length)
        for (name, other), (field, length) in lengths.items()
        if (other, name) not in lengths or int(name) <= int(other)
    ]
    return SimulatorGraph(vertices, edges)
