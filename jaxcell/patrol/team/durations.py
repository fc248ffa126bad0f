import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.quantities import Checks, Result, derived, quantity
from ...optimize import GraphLike
from .idleness import idleness_over_vertices
from .times import check_walks, hitting_check, move_times


@dataclasses.dataclass(frozen=True, eq=False)
class Timed(Result):
    """Times of a walk in seconds, if each step takes the travel time of its edge."""

    title: ClassVar[str] = "Random walk with travel times"
    tables: ClassVar[Mapping[str, str]] = {"edge": "edges"}

    duration: Annotated[
        Float[np.ndarray, "edges"], quantity("edge", "time that it takes", "s", kind="time")
    ]
    wait: Annotated[float, quantity("", "time that a step without moving takes", "s", kind="time")]
    step: Annotated[
        Float[np.ndarray, "vertices"],
        quantity("vertex", "mean time of a step from it", "s", kind="time"),
    ]
    hitting_time: Annotated[
        Float[np.ndarray, "vertices vertices"] | None,
        quantity("start target", "mean time until first there", "s", kind="time"),
    ]
    "The hitting times, or `None` if robots walk differently."
    mean_step: Annotated[float, quantity("", "mean time of a step", "s", kind="time")]
    idleness: Annotated[
        Float[np.ndarray, "vertices"],
        quantity("vertex", "time between visits by any robot, mean", "s", kind="time"),
    ]
    transition: Float[np.ndarray, "vertices vertices"]

    @derived("", "mean hitting time over pairs of vertices", "s", kind="time")
    def mean_hitting_time(self) -> float | None:
        if self.hitting_time is None:
            return None
        vertices = self.step.size
        return float(self.hitting_time.sum() / (vertices * (vertices - 1)))

    @derived("", "mean commute time over pairs of vertices", "s", kind="time")
    def mean_commute_time(self) -> float | None:
        return None if self.mean_hitting_time is None else 2 * self.mean_hitting_time

    mean_idleness, worst_idleness = idleness_over_vertices("s")

    def checks(self) -> Checks:
        if self.hitting_time is None:
            return {}
        residual = hitting_check(self.transition, self.step, self.hitting_time)
        return {"timed_hitting_time_residual": residual}


def timed(
    graph: GraphLike,
    matrices: Float[np.ndarray, "robots vertices vertices"],
    shares: Float[np.ndarray, "robots vertices"],
    durations: Any,
    wait: float,
) -> Timed:
    """Compute hitting times and idleness in seconds, for walks along edges with travel times.

    The walks are semi-Markov processes. With `s` the mean times of steps, hitting times solve `h =
    s + P h`, and the mean time between two departures of a robot from vertex `j` is `pi s / pi_j`.

    **Arguments:** the graph; the transition matrix of each robot; the share of steps of each robot
    that begin at each vertex; the travel time of each edge, in seconds; and the duration of a step
    that stays at a vertex. **Returns:** [`Timed`][]; steps are those of a robot drawn at random.

    A random walk on a line of three vertices, whose second edge takes ten times as long:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> walk = np.array([[[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]])
        >>> times = patrol.team.timed(graph, walk, np.array([[0.25, 0.5, 0.25]]), [1, 10], 1.0)
        >>> times.hitting_time.round(6).tolist()
        [[0.0, 1.0, 13.0], [21.0, 0.0, 12.0], [31.0, 10.0, 0.0]]
    """
    check_walks(graph, matrices)
    if not 0 < wait < np.inf:
        raise ValueError(f"wait: expected a positive finite time, got {wait}")
    durations = np.array(durations, np.float64)
    taken = move_times(graph, durations, wait)
    steps = (matrices * taken).sum(axis=2)
    means = (shares * steps).sum(axis=1)
    alike = bool((matrices == matrices[0]).all())
    with np.errstate(divide="ignore"):
        idleness = 1 / (shares / means[:, None]).sum(axis=0)
    return Timed(
        duration=durations,
        wait=wait,
        step=steps.mean(axis=0),
        hitting_time=_hitting(matrices[0], shares[0], steps[0]) if alike else None,
        mean_step=float(means.mean()),
        idleness=idleness,
        transition=matrices[0],
    )


def _hitting(
    matrix: Float[np.ndarray, "vertices vertices"],
    share: Float[np.ndarray, "vertices"],
    step: Float[np.ndarray, "vertices"],
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the mean hitting times, infinite for targets that are not visited in the long run.

    With the fundamental matrix `Z = (I - P + 1 pi)^-1` and the mean time `s_i` of a step from `i`,
    the hitting times are `(Z s)_i - (Z s)_j + pi s (z_jj - z_ij) / pi_j`.
    """
    try:
        inverse = np.linalg.inv(np.eye(share.size) - matrix + share)
    except np.linalg.LinAlgError:
        raise ValueError(
            "matrices: robot 0 visits different vertices in the long run from different starts; "
            "expected a walk that visits the same vertices from all starts"
        ) from None
    ahead, visited = inverse @ step, share > 0
    times = np.full(matrix.shape, np.inf)
    own = np.diag(inverse)[visited] - inverse[:, visited]
    times[:, visited] = ahead[:, None] - ahead[visited] + share @ step * own / share[visited]
    np.fill_diagonal(times, 0)
    return np.maximum(times, 0)
