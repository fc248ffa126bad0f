"""Small objects for the examples in docstrings: a corridor, a lab, a sea, a patrol, and others.

>>> from jaxcell import examples
>>> examples.corridor().size, examples.lab().size
(6, 152)
"""

import atexit
import functools
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool

from . import automata, drift, dynamics, mapping, markov, optimize, space, sweep
from .base.bundled import bundled
from .base.shown import own_names


if TYPE_CHECKING:
    from . import robot

__dir__ = functools.partial(own_names, globals())


def folder() -> Path:
    """Create an empty folder, which is removed when Python ends."""
    path = tempfile.mkdtemp(prefix="jaxcell-")
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return Path(path)


def corridor(directions: int = 2) -> "space.CellSpace":
    """Build a corridor of three squares of 1 m from West to East, with a wall around it."""
    return space.CellSpace.of(space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)]), 1.0, directions)


def lab() -> "space.CellSpace":
    """Load Lab A of Alam 2018: 19 positions in a room of 8 m x 4 m, and 8 directions."""
    return space.CellSpace.load(bundled("lab_a"))


def ring() -> "automata.Filter":
    """Build the filter of a robot that cycles through three cells, and bumps in the last cell."""
    return automata.Filter.of(
        automata.subset_construction(np.array([1, 2, 0]), np.array([False, False, True]))
    )


def walker(x: float = 0.5, direction: int = 0) -> "robot.Walker":
    """Put an emulated robot into the corridor at `x` metres, in one of 4 directions."""
    from . import robot
    from .robot.emulation.body import Body
    from .robot.emulation.simulated import SimulatedCreate

    body = SimulatedCreate(Body(corridor().room, (x, 0.5, direction * np.pi / 2)))
    return robot.Walker(body, 1.0, strides=robot.cell_strides(4, 1.0, 1.0), direction=direction)


def patrol_task() -> "robot.PatrolTask":
    """Build the task of a robot that patrols between the ends of the corridor."""
    from . import robot

    walk = np.array([[2, 1, 0]]), np.ones((1, 3))
    path = folder() / "patrol.json"
    robot.save_patrols(path, corridor(directions=4), [walk], [0], 1.5)
    task = robot.load_task(path)
    assert isinstance(task, robot.PatrolTask)
    return task


def walk() -> "mapping.Chain":
    """Build the chain of a random walk on a line of three cells, which turns back at the ends."""
    return _chain([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])


def ruin() -> "mapping.Chain":
    """Build the chain of a random walk on a line of four cells, which stops at both ends."""
    return _chain([[1, 0, 0, 0], [0.5, 0, 0.5, 0], [0, 0.5, 0, 0.5], [0, 0, 0, 1]])


def stream() -> "mapping.Chain":
    """Build the chain of four cells of the sea: cell 0 flows into 1, and cell 1 into 2 and 3."""
    return _chain([[0.5, 0.5, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]])


def line_model() -> "markov.DecisionModel":
    """Build the decision model of a robot on a line of three cells, with reward 1 in the last."""
    right, left = [[0, 1, 0], [0, 0, 1], [0, 0, 1]], [[1, 0, 0], [1, 0, 0], [0, 1, 0]]
    return markov.DecisionModel.of([_chain(right), _chain(left)], [[0, 0, 1], [0, 0, 1]])


def _chain(matrix: Any) -> "mapping.Chain":
    return mapping.Chain.from_scipy(np.array(matrix))


def sea() -> "drift.Sea":
    """Build a sea of two layers of three cells: the upper flows East, the lower flows West."""
    layers = [water([[1, 1, 1]], depth) for depth in (0.0, 5.0)]
    ends = [1, 2, 2], [0, 0, 1]
    return drift.Sea.of(
        layers, [mapping.Chain(np.array([to], np.int32), np.ones((1, 3))) for to in ends]
    )


def water(wet: npt.ArrayLike, depth: float = 0.0) -> "drift.Water":
    """Build a layer of water with squares of 1 km at a depth in metres; `wet` is 0 for land."""
    wet = np.asarray(wet, bool)
    number = np.where(wet, np.cumsum(wet).reshape(wet.shape) - 1, -1).astype(np.int32)
    side, zero = np.full(wet.shape, 1000.0), np.zeros(wet.shape)
    return drift.Water(number, side, side, zero, zero, zero, depth)


def gyres() -> "tuple[drift.Water, drift.Flow]":
    """Load the surface of the bundled sea, and its current in the first hour."""
    currents = drift.open_currents(bundled("gyres"), time=0, depths=0)
    return drift.Water.of(currents), drift.Flow.of(currents)


def patrol() -> "tuple[optimize.Graph, Bool[np.ndarray, '5 5']]":
    """Build a path graph of five vertices, and its visibility matrix.

    A robot sees its own vertex and the adjacent vertices.
    """
    graph = optimize.Graph([(i, i + 1) for i in range(4)], xy=[(i, 0) for i in range(5)])
    return graph, np.abs(np.subtract.outer(range(5), range(5))) <= 1


def basins(cells: int = 8) -> "dynamics.Basins":
    """Compute the basins of a map of [0, 1]: numbers above 1/2 go to 0.6, other numbers to 0.1."""
    return dynamics.basins(_two_ends, space.Box([0], [1], cells=[cells]))


def _two_ends(x: Any, p: Any) -> Any:
    import jax.numpy as jnp

    return jnp.where(x > 0.5, 0.6, 0.1)


def angles(chunk: int = 64) -> "sweep.Spec":
    """Specify a sweep over two bouncing angles in Lab A, in jobs of at most `chunk` angles."""
    lines = (
        'task = "groups"',
        f"chunk = {chunk}",
        "[grid]",
        "bounce = [45, 135]",
        "[fixed]",
        'map = "@lab_a"',
    )
    path = folder() / "angles.toml"
    path.write_text("\n".join(lines))
    return sweep.Spec.load(path)
