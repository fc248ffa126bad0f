import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...base.documents import Fields, about, check_file, checked_list, decode_json, read_text
from ...optimize import Graph
from ...optimize.validation import distribution
from ..team.times import directed_times


class WalkProblem(NamedTuple):
    """A problem for [`jaxcell.patrol.maximin_capture`][], whose arguments have these names."""

    graph: Graph
    travel_times: Int[np.ndarray, "vertices vertices"]
    "The time from each vertex to each, 0 if there is no way; the diagonal has those of waits."
    attack_time: int
    stationary: Float[np.ndarray, "vertices"] | None


def load_problem(path: str | os.PathLike[str]) -> WalkProblem:
    """Read a problem of RoSSO (John et al. 2023): times in both directions, attack, and shares.

    **Arguments:** a JSON file with the object `problem_params`. It has `weight_matrix`, `tau`, and
    perhaps `stationary_distribution`; other fields are ignored. **Returns:** `WalkProblem`.

    Two crossings, with 3 steps there and 2 back:

        >>> from jaxcell import examples, patrol
        >>> path = examples.folder() / "problem.json"
        >>> _ = path.write_text('{"problem_params": {"tau": 4, "weight_matrix": [[1, 3], [2, 1]]}}')
        >>> problem = patrol.files.load_problem(path)
        >>> problem.travel_times.tolist(), problem.attack_time
        ([[1, 3], [2, 1]], 4)
    """
    path = Path(path)
    check_file(path, "a problem of RoSSO")
    with about(path):
        document = decode_json(read_text(path), "a problem of RoSSO")
        problem = document.get("problem_params") if isinstance(document, dict) else None
        if not isinstance(problem, dict):
            raise ValueError("expected an object with the object problem_params")
        fields = Fields(problem, "problem_params.")
        count = len(checked_list("problem_params.weight_matrix", fields.get("weight_matrix")))
        times = fields.numbers("weight_matrix", (count, count), whole=True)
        graph = Graph(np.argwhere(np.triu(np.maximum(times, times.T), 1) > 0), count)
        share = fields.get("stationary_distribution")
        if share is not None:
            share = fields.numbers("stationary_distribution", (count,), whole=False)
            share = distribution("stationary_distribution", share, count, "per vertex")
        attack = fields.whole("tau", 1, 100_000)
        return WalkProblem(graph, directed_times(graph, times), attack, share)
