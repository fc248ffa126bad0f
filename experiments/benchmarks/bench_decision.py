"""Times value iteration for a drifter's voyage beside quantecon and pymdptoolbox.

Run `python experiments/benchmarks/bench_decision.py`; it takes about a minute, and with `--large`,
a million cells, about three more. Peers that are not installed are skipped.

The sea has three layers of gyres, turned against each other. A drifter is carried to one of four
cells, or goes up or down where there is a layer, and is to come to one cell (Alam 2018, Alg. 5.5).
All programs have the same model, discount and tolerance of the value. That of the others is `V /
discount` in our convention; `off` is the largest difference after that is undone. They have no
sink: there, the goal is a cell that is never left and gains nothing. quantecon takes the actions
that are allowed; pymdptoolbox takes all, and those that are not allowed cost 10^6 here; its
checks want a full matrix, which ends it for large models. Beside them is the surest voyage, which
has no discount, where it does not take minutes. A first call compiles, unless the cache has it.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import scipy.sparse

from jaxcell.drift.sea import Sea
from jaxcell.drift.voyage import voyage_model
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain
from jaxcell.markov.decision import DecisionModel, value_iteration
from jaxcell.markov.shortest_path import stochastic_shortest_path
from jaxcell.runtime import configure_jax


try:
    import quantecon
except ImportError:
    quantecon = None
try:
    import mdptoolbox.mdp as mdptoolbox
except ImportError:
    mdptoolbox = None


TOLERANCE = 1e-8
FORBIDDEN = -1e6


def gyres(rows: int, columns: int) -> Sea:
    """Three layers of water without land."""
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


def matrices(model: DecisionModel, goal: int) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """Transition matrices that stay in the goal, rewards, and where actions are allowed."""
    stay = scipy.sparse.csr_array(([1.0], ([goal], [goal])), shape=(model.cells, model.cells))
    moves = [(chain.to_scipy() + stay).tocsr() for chain in model.chains]
    return moves, np.array(model.reward), np.array(model.allowed)


def with_quantecon(model: DecisionModel, goal: int, discount: float, method: str) -> Any:
    moves, reward, allowed = matrices(model, goal)
    # By cell and then by action, which is the order that it wants.
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


def timed(program: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = jax.block_until_ready(program())
    return time.perf_counter() - began, result


def side_by_side(rows: int, columns: int, discount: float, repeats: int) -> None:
    sea = gyres(rows, columns)
    goal = rows * columns + rows * columns // 3 + columns // 2
    model = voyage_model(sea, goal, discount)
    cells = f"{model.cells:,}"
    first, _ = timed(lambda: value_iteration(model, discount, TOLERANCE).value)
    ours = [timed(lambda: value_iteration(model, discount, TOLERANCE)) for _ in range(repeats)]
    least, found = min(seconds for seconds, _ in ours), ours[0][1]

    def row(program: str, seconds: list[float], off: str) -> None:
        print(
            f"| {cells} | {discount:g} | {program} | {min(seconds):.3f} | "
            f"{statistics.median(seconds):.3f} | {min(seconds) / least:.3g} | {off} |",
            flush=True,
        )

    row(f"jaxcell ({found.iterations} sweeps)", [t for t, _ in ours], f"{found.gap:.0e} (bound)")
    row("jaxcell, first call", [first], "")
    others: list[tuple[str, Callable[..., Any], str]] = []
    if quantecon is not None:
        others += [
            ("quantecon", with_quantecon, "value_iteration"),
            ("quantecon", with_quantecon, "modified_policy_iteration"),
        ]
    if mdptoolbox is not None:
        others += [
            ("pymdptoolbox", with_mdptoolbox, "ValueIteration"),
            ("pymdptoolbox", with_mdptoolbox, "PolicyIterationModified"),
        ]
    for name, prepare, method in others:
        try:
            program = prepare(model, goal, discount, method)
            program() if rows < 100 and name == "quantecon" else None  # it compiles
            seconds, value = timed(program)
        except Exception as error:
            print(f"| {cells} | {discount:g} | {name} {method} | {error} |||")
            continue
        off = np.abs(discount * np.asarray(value) - np.asarray(found.value)).max()
        row(f"{name} {method}", [seconds], f"{off:.0e}")
    if model.cells > 500_000:
        return
    seconds, path = timed(lambda: stochastic_shortest_path(model, goal))
    row(f"surest voyage ({path.certificate.iterations} rounds)", [seconds], "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true", help="a million cells as well")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs of ours")
    arguments = parser.parse_args()
    configure_jax()
    for name, module in (("quantecon", quantecon), ("pymdptoolbox", mdptoolbox)):
        if module is None:
            print(f"{name} is not installed; skipped (pip install {name})")
    print(f"jax {jax.__version__}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| cells | discount | program | min, s | median, s | to ours | off |")
    print("|--:|--:|---|--:|--:|--:|--:|")
    for discount in (0.9, 0.99):
        side_by_side(21, 29, discount, arguments.repeats)
    side_by_side(183, 183, 0.99, arguments.repeats)
    if arguments.large:
        side_by_side(578, 577, 0.99, arguments.repeats)


if __name__ == "__main__":
    main()
