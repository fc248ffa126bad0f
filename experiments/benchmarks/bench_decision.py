"""Time value iteration for a drifter's voyage beside quantecon and pymdptoolbox.

Run `python experiments/benchmarks/bench_decision.py`; it takes about half a minute, and with
`--full`, a million cells, about three minutes more.

The sea has three layers of gyres with different phases. A drifter drifts to one of four cells, or
goes up or down to another layer, and has a cell as its goal (Alam 2018, Alg. 5.5). All programs
have the same model, discount and tolerance of the value. The value of the others is `V / discount`
in our convention; `off` is the largest difference after a conversion. They have no sink, so the
goal is a cell that is never left, with reward 0. quantecon has only the allowed actions.
pymdptoolbox has all actions, and other actions cost 10^6 here; its checks make a dense matrix, so
it fails for large models. The surest voyage, which has no discount, is included where it does not
take minutes. A first call compiles.
"""

import statistics
from collections.abc import Callable
from typing import Any

import mdptoolbox.mdp as mdptoolbox
import numpy as np
import quantecon
import scipy.sparse
from rows import Row, options, write_rows
from timing import begin, header, line, timed

from jaxcell.drift.layered_cells import Sea
from jaxcell.drift.voyage_policies import voyage_model
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain
from jaxcell.markov.decision import DecisionModel
from jaxcell.markov.discounted import value_iteration
from jaxcell.markov.shortest_path import stochastic_shortest_path


TOLERANCE = 1e-8
FORBIDDEN = -1e6


def gyres(rows: int, columns: int) -> Sea:
    """Make three layers of water without land."""
    y, x = np.divmod(np.arange(rows * columns), columns)
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    side, zero = np.full(number.shape, 1000.0), np.zeros(number.shape)
    waters, chains = [], []
    for layer in range(3):
        turn = 2 * np.pi * layer / 3
        u = np.round(2 * np.sin(4 * np.pi * y / rows + turn)).astype(int)
        v = np.round(2 * np.cos(4 * np.pi * x / columns + turn)).astype(int)
        ends = [(u, v), (u + 1, v), (u, v + 1), (u - 1, v - 1)]
        image = [
            np.clip(y + up, 0, rows - 1) * columns + np.clip(x + right, 0, columns - 1)
            for right, up in ends
        ]
        share = np.broadcast_to(np.array([[0.7], [0.1], [0.1], [0.1]]), (4, y.size))
        waters.append(Water(number, side, side, zero, zero, zero, 5.0 * layer))
        chains.append(Chain(np.stack(image), np.array(share)))
    return Sea.of(waters, chains)


def matrices(model: DecisionModel, goal: int | None) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """Make transition matrices that stay in a goal, rewards, and a mask of allowed actions."""
    moves = [chain.to_scipy() for chain in model.chains]
    if goal is not None:
        stay = scipy.sparse.csr_array(([1.0], ([goal], [goal])), shape=moves[0].shape)
        moves = [(move + stay).tocsr() for move in moves]
    return moves, np.array(model.reward), np.array(model.allowed)


def with_quantecon(model: DecisionModel, goal: int | None, discount: float, method: str) -> Any:
    moves, reward, allowed = matrices(model, goal)
    # quantecon expects pairs in the order of cells, then of actions.
    cell, action = np.nonzero(allowed.T)
    rows = scipy.sparse.vstack(moves, format="csr")[action * model.cells + cell]
    rows = scipy.sparse.csr_matrix(rows)
    problem = quantecon.markov.DiscreteDP(reward[action, cell], rows, discount, cell, action)
    return lambda: problem.solve(method=method, epsilon=TOLERANCE, max_iter=10**6).v


def with_mdptoolbox(model: DecisionModel, goal: int, discount: float, method: str) -> Any:
    moves, reward, allowed = matrices(model, goal)
    for action, may in enumerate(allowed):
        stays = scipy.sparse.diags_array((~may).astype(float))
        kept = scipy.sparse.diags_array(may.astype(float))
        moves[action] = scipy.sparse.csr_matrix(kept @ moves[action] + stays)
    reward = np.where(allowed, reward, FORBIDDEN)

    def solve() -> Any:
        make = getattr(mdptoolbox, method)
        problem = make(moves, reward.T, discount, epsilon=TOLERANCE, max_iter=10**6)
        problem.run()
        return np.array(problem.V)

    return solve


def side_by_side(rows: int, columns: int, discount: float, repeats: int) -> list[Row]:
    """Time all programs on a sea."""
    sea = gyres(rows, columns)
    goal = rows * columns + rows * columns // 3 + columns // 2
    model = voyage_model(sea, goal, discount)
    cells = f"{model.cells:,}"
    first, _ = timed(lambda: value_iteration(model, discount, TOLERANCE).value)
    ours = [timed(lambda: value_iteration(model, discount, TOLERANCE)) for _ in range(repeats)]
    least, found = min(seconds for seconds, _ in ours), ours[0][1]

    def row(program: str, seconds: list[float], off: str) -> None:
        times = (f"{min(seconds):.3f}", f"{statistics.median(seconds):.3f}")
        line(cells, f"{discount:g}", program, *times, f"{min(seconds) / least:.3g}", off)

    row(f"jaxcell ({found.iterations} rounds)", [t for t, _ in ours], f"{found.gap:.0e} (bound)")
    row("jaxcell, first call", [first], "")

    def peer(name: str, prepare: Callable[..., Any], method: str) -> float | None:
        """Time another program; `None` if it fails."""
        try:
            program = prepare(model, goal, discount, method)
            program() if rows < 100 and name == "quantecon" else None  # compiles
            seconds, value = timed(program)
        except Exception as error:
            line(cells, f"{discount:g}", f"{name} {method}", error, "", "", "")
            return None
        off = np.abs(discount * np.asarray(value) - np.asarray(found.value)).max()
        row(f"{name} {method}", [seconds], f"{off:.0e}")
        return seconds

    median = statistics.median(seconds for seconds, _ in ours)
    what = f"value iteration, {len(model.chains)} actions, discount {discount:g}"
    measured = []
    for name, prepare, method in (
        ("quantecon", with_quantecon, "value_iteration"),
        ("quantecon", with_quantecon, "modified_policy_iteration"),
        ("pymdptoolbox", with_mdptoolbox, "ValueIteration"),
        ("pymdptoolbox", with_mdptoolbox, "PolicyIterationModified"),
    ):
        theirs = peer(name, prepare, method)
        program = f"{name}, {method}"
        measured.append(Row("decision", what, f"{cells} cells", median, program, theirs))
    if model.cells < 500_000:
        seconds, path = timed(lambda: stochastic_shortest_path(model, goal))
        row(f"surest voyage ({path.certificate.iterations} rounds)", [seconds], "")
    return measured


def main() -> None:
    arguments = options(__doc__, repeats=3, full="a million cells").parse_args()
    begin("jax", "numpy", "quantecon", "pymdptoolbox")
    header("cells", "discount", "program", "min, s", "median, s", "to ours", "off", words=3)
    rows = []
    side_by_side(21, 29, 0.9, arguments.repeats)
    rows += side_by_side(21, 29, 0.99, arguments.repeats)
    rows += side_by_side(183, 183, 0.99, arguments.repeats)
    if arguments.full:
        rows += side_by_side(578, 577, 0.99, arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
